"""Where motion synthesis brings the object: target poses and trajectories (paper, sections 3.3 and 4.5)."""
