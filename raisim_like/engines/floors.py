"""The smallest inertia and mass of a link in any engine; smaller ones make the solvers fail."""

LIGHT_INERTIA = 1e-6
"""kg m^2 about a principal axis."""
MIN_MASS = 1e-5
"""kg. PyBullet would fix a link without mass."""
