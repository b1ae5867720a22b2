"""The build backend: maturin, with the program `rayset` built first and put into the wheel as a script.

A script that is a native program has no Python in its process, so that `--memory` bounds all of it; an entry point would start an
interpreter first. Both are built with the settings below, nearly as fast as the release's own and in a third of the time; what
the environment says of Cargo's release profile comes first. `RAYSET_PROGRAM_FILE` names a program that has been built already.
"""

import os
import shutil
import subprocess
from pathlib import Path

import maturin
from maturin import get_requires_for_build_editable, get_requires_for_build_wheel  # noqa: F401

HERE = Path(__file__).resolve().parent.parent
#: The same for both, so that what both are made of is compiled once.
SETTINGS = {"CARGO_PROFILE_RELEASE_LTO": "thin", "CARGO_PROFILE_RELEASE_CODEGEN_UNITS": "8", "CARGO_PROFILE_RELEASE_DEBUG": "0"}


def _put_program() -> None:
    """Builds the program, and puts it where maturin takes it from."""
    for key, value in SETTINGS.items():
        os.environ.setdefault(key, value)
    target = os.environ.get("CARGO_BUILD_TARGET", "")
    name = "rayset.exe" if (os.name == "nt" if not target else "windows" in target) else "rayset"
    scripts = HERE / "wheel-data" / "scripts"
    scripts.mkdir(parents=True, exist_ok=True)
    given = os.environ.get("RAYSET_PROGRAM_FILE")
    if given:
        shutil.copy2(given, scripts / name)
        return
    folder = Path(os.environ.setdefault("CARGO_TARGET_DIR", str(HERE / "target"))).resolve()
    command = ["cargo", "build", "--release", "--locked", "--package", "rayset-cli", "--features", "far"]
    subprocess.run(command, cwd=HERE.parent, check=True)
    shutil.copy2(folder / target / "release" / name, scripts / name)


def prepare_metadata_for_build_wheel(metadata_directory, config_settings=None):
    (HERE / "wheel-data" / "scripts").mkdir(parents=True, exist_ok=True)
    return maturin.prepare_metadata_for_build_wheel(metadata_directory, config_settings)


prepare_metadata_for_build_editable = prepare_metadata_for_build_wheel


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    _put_program()
    return maturin.build_wheel(wheel_directory, config_settings, metadata_directory)


def build_editable(wheel_directory, config_settings=None, metadata_directory=None):
    _put_program()
    return maturin.build_editable(wheel_directory, config_settings, metadata_directory)


def build_sdist(sdist_directory, config_settings=None):
    raise RuntimeError("a source distribution would need the workspace around this folder; install from a checkout, or from a wheel")
