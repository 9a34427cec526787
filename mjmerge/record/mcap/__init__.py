"""MCAP recordings: recorder and reader."""
