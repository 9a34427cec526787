"""Campaigns: many runs by plan, on many processes, into one table and a report."""
