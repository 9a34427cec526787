"""What a trace is worth: hypotheses, verdict, metrics, phases, summary."""
