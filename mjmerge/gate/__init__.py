"""The regression gate: rows, baselines, reports, pytest plugin."""
