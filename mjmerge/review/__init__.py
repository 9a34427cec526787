"""Recordings judged: verify, replay, recover, compare, convert, video, view."""
