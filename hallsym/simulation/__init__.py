"""Logs of machines that are known: campaigns, trajectories, noise, and the simulated machine."""
