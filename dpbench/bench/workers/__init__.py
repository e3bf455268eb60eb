"""Processes: started, supervised, run in slots or by turns."""
