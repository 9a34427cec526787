"""Recorded traffic: files of others read into tracks and lanes, smoothed, and their lane changes found."""
