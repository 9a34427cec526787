"""What the paper says, reproduced: figures, facts, theorem, survey."""
