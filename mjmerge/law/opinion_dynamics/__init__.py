"""The paper's law: opinion, barrier, tracking."""
