"""What pyproject.toml cannot say: the part in C, which is left out where there is no compiler."""

import sys
from importlib.util import find_spec
from pathlib import Path

from setuptools import Extension, setup

mujoco = find_spec("mujoco")
sliding = Extension(
    "raisim_like.engines.mujoco._sliding",
    ["raisim_like/engines/mujoco/sliding.c"],
    include_dirs=[str(Path(mujoco.origin).parent / "include")] if mujoco and mujoco.origin else [],
    # A fused multiplication and addition would round otherwise than NumPy does.
    extra_compile_args=[] if sys.platform == "win32" else ["-O2", "-ffp-contract=off"],
    py_limited_api=True,
    optional=True,
)
setup(ext_modules=[sliding], options={"bdist_wheel": {"py_limited_api": "cp310"}})
