"""Rerun recordings: recorder, reader, layout and viewer."""
