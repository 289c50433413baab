"""Names and defaults that `--help` shows, apart from the code behind them, which takes seconds to import."""

BASELINES = ("flat_rl", "gt_ik", "gt_pd", "learned_motion", "static_grasp")
"""What `--baseline` takes: the names of `dgrasp.methods.METHODS` except the policy's."""
TABLES = ("grasp", "motion", "ablation", "unseen", "scope", "recipe")
"""What `--table` takes: the tables of `dgrasp.tables.plan`."""
MANO_CONVENTIONS: dict[str, tuple[str, ...]] = {
    "pose": ("pca", "axis-angle"), "mean": ("flat", "mano"), "fingers": ("mano", "project"),
    "transl": ("mano", "wrist"), "quaternion": ("wxyz", "xyzw"),
}  # fmt: skip
"""The open questions of a table of MANO parameters, each an option of `labels import mano`, and their answers.

pose: PCA coefficients or rotation vectors. mean: they count from the flat hand or from MANO's mean pose. fingers:
index, middle, little, ring, thumb, or index, middle, ring, little, thumb. transl: MANO's translation of the mesh, or
the wrist's position. quaternion: the order of `object_rotation`'s four numbers.
"""
MANO_SOURCES = ("hamer", "wilor", "grasptta", "contactopt", "dexgraspnet", "grab")
"""What `--from` takes: the sources of `dgrasp.labels.recorded.table_sources`."""
DISPLACEMENT = 0.01
"""m from where the object lay; in the labels of the authors' release it is 9 mm (median)."""
START_DISTANCE = 0.20
"""m between wrist and object at the start; in the labels of the authors' release it is 0.18 to 0.20."""
PRIMITIVES = ("box", "cylinder", "sphere", "capsule")
"""Shapes that `object add` fits."""
OVERLAP = 0.9
"""Overlap from which a single primitive is taken."""
DENSITY = 500.0
"""kg/m^3 where neither mass nor density is given: household objects are part hollow."""
MOST_LABELS = 1000
"""Most labels of one object that are made at once."""
