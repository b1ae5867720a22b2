"""The build backend: maturin, with the program `rayset` built first and put into the wheel as a script.

A script that is a native program has no Python in its process, so that `--memory` bounds all of it; an entry point would start an
interpreter first. The program and the extension module are targets of one package: what both are made of, the engine above all, is
compiled once, into the program's own target folder unless CARGO_TARGET_DIR names another. Both are made in Cargo's profile `release`,
or in the one that maturin is given: `pip install --config-settings=build-args="--profile dev" ./python`. `RAYSET_PROGRAM_FILE` names
a program that has been built already.

A build takes minutes, and pip hides what it prints unless it is called with `-v`. What is being done is therefore said on the
terminal, too, if there is one.
"""

import contextlib
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import maturin
from maturin import get_requires_for_build_editable, get_requires_for_build_wheel  # noqa: F401

HERE = Path(__file__).resolve().parent.parent
#: Seconds between two lines of a compilation that goes on.
EVERY = 15.0


class _Teller:
    """Says what is done to whoever waits for it."""

    def __init__(self) -> None:
        self._begun = time.monotonic()

    def say(self, words: str) -> None:
        seconds = round(time.monotonic() - self._begun)
        line = f"rayset [{seconds // 60}:{seconds % 60:02}] {words}"
        print(line, file=sys.stderr, flush=True)
        if not sys.stderr.isatty():
            # Of a build without a terminal, as on a server, nobody waits there.
            with contextlib.suppress(OSError), open("/dev/tty", "w") as terminal:
                terminal.write(f"\r{line}\n")


def _compile(command: list, teller: _Teller) -> None:
    """Runs Cargo, whose lines are passed on, and says now and then how far it is."""
    count, last = 0, time.monotonic()
    process = subprocess.Popen(command, cwd=HERE, stderr=subprocess.PIPE, text=True, errors="replace")
    for line in process.stderr:
        print(line, end="", file=sys.stderr, flush=True)
        words = line.split()
        if words[:1] == ["Compiling"]:
            count += 1
            is_engine = words[1] == "rayset"
            if is_engine or time.monotonic() - last > EVERY:
                last = time.monotonic()
                teller.say(f"compiling package {count}: {'the engine, the longest of them' if is_engine else words[1]}")
    if process.wait() != 0:
        raise SystemExit(f"{' '.join(command)} failed; what it said is above, or shown by `pip install -v`")


def _profile(config_settings) -> str:
    """The profile of Cargo that maturin takes by the arguments that it is given."""
    args = (config_settings or {}).get("build-args", "")
    words = [word for arg in ([args] if isinstance(args, str) else args) for word in arg.replace("=", " ").split()]
    return words[words.index("--profile") + 1] if "--profile" in words[:-1] else "release"


def _put_program(teller: _Teller, profile: str) -> None:
    """Builds the program, and puts it where maturin takes it from."""
    target = os.environ.get("CARGO_BUILD_TARGET", "")
    name = "rayset.exe" if (os.name == "nt" if not target else "windows" in target) else "rayset"
    scripts = HERE / "wheel-data" / "scripts"
    scripts.mkdir(parents=True, exist_ok=True)
    given = os.environ.get("RAYSET_PROGRAM_FILE")
    if given:
        shutil.copy2(given, scripts / name)
        return
    folder = Path(os.environ.setdefault("CARGO_TARGET_DIR", str(HERE.parent / "target"))).resolve()
    teller.say(f"compiling the engine and the program, with Cargo in {folder}: some minutes; what is there already is used again")
    _compile(["cargo", "build", "--profile", profile, "--locked", "--bin", "rayset"], teller)
    shutil.copy2(folder / target / ("debug" if profile == "dev" else profile) / name, scripts / name)


def prepare_metadata_for_build_wheel(metadata_directory, config_settings=None):
    (HERE / "wheel-data" / "scripts").mkdir(parents=True, exist_ok=True)
    return maturin.prepare_metadata_for_build_wheel(metadata_directory, config_settings)


prepare_metadata_for_build_editable = prepare_metadata_for_build_wheel


def _build(build, wheel_directory, config_settings, metadata_directory):
    teller = _Teller()
    _put_program(teller, _profile(config_settings))
    teller.say("linking the extension module of the same engine")
    wheel = build(wheel_directory, config_settings, metadata_directory)
    teller.say("done")
    return wheel


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    return _build(maturin.build_wheel, wheel_directory, config_settings, metadata_directory)


def build_editable(wheel_directory, config_settings=None, metadata_directory=None):
    return _build(maturin.build_editable, wheel_directory, config_settings, metadata_directory)


def build_sdist(sdist_directory, config_settings=None):
    raise RuntimeError("a source distribution would need the workspace around this folder; install from a checkout, or from a wheel")
