"""D-Grasp on open physics: dynamic grasps from static grasp labels (Christen et al., CVPR 2022)."""

__version__ = "0.1.0"
