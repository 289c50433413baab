"""The terms of use that are written into files and results. Each text is defined once."""

from __future__ import annotations

PROJECT = "MIT"
"""Terms of what the project made itself: the free hand, the free objects, and labels of only these."""
FREE_HAND = f"{PROJECT}, as the project"
"""Terms of hands built from the free hand's skin."""
MANO = "derived from MANO: non-commercial research only, no redistribution"
"""Terms of hands and poses that come from MANO."""
DEXYCB = f"DexYCB CC BY-NC 4.0; {MANO}"
HO3D = f"HO3D: academic research only; {MANO}"
OF_ITS_ORIGINS = "that of the hand and of the objects that they were made for"
"""Terms of synthesised labels for the user's own hand or objects."""
