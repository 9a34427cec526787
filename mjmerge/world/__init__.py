"""The MJCF world of a scenario."""
