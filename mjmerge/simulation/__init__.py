"""The loop of a run, what the ego is told, continuous time, and the trace."""
