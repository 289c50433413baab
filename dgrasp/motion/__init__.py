"""Targets of motion synthesis: poses and trajectories of the object (paper, sections 3.3 and 4.5)."""
