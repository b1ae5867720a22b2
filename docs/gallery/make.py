#!/usr/bin/env python3
"""Makes the pictures of docs/gallery.md from pictures.toml, and the page itself.

    docs/gallery/make.py PROGRAM [--data FOLDER] [--only NAME ...] [--small] [--work FOLDER] [--write]

PROGRAM is the rayset to run. Without --data only the pictures whose points the program generates are made. --small makes
thumbnails, which show that every command still works. --write puts pictures, times and memory into docs/. Every command runs
in the working folder, where the scenes of this folder and the files of the data folder can be found by their bare names.
Needs Python 3.11 and nothing else.
"""

import argparse
import json
import os
import pathlib
import shlex
import shutil
import struct
import sys
import tempfile
import time
import tomllib

HERE = pathlib.Path(__file__).resolve().parent
PAGE = HERE.parent / "gallery.md"
PICTURES = HERE.parent / "pictures" / "gallery"
MEASURED = HERE / "measured.json"


def run(arguments, folder):
    """Runs a command; returns seconds and peak memory in MiB. Ends the script if it fails."""
    begun = time.monotonic()
    child = os.fork()
    if child == 0:
        os.chdir(folder)
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.execv(arguments[0], arguments)
    _, status, used = os.wait4(child, 0)
    if status != 0:
        sys.exit(f"failed: {' '.join(arguments)}")
    return time.monotonic() - begun, used.ru_maxrss / 1024


def size_of(png):
    head = png.read_bytes()[:26]
    if head[:8] != b"\x89PNG\r\n\x1a\n":
        sys.exit(f"{png} is no PNG")
    return struct.unpack(">II", head[16:24])


def prepare(folder, data):
    for scene in HERE.glob("*.json"):
        if scene != MEASURED:
            shutil.copy(scene, folder)
    for scene in (HERE.parent.parent / "examples").glob("*.json"):
        shutil.copy(scene, folder)
    if data:
        for file in pathlib.Path(data).rglob("*"):
            link = folder / file.name
            if file.is_file() and not link.exists():
                link.symlink_to(file.resolve())


def make(entry, arguments, folder):
    """Makes one picture; returns what is measured of its last command, or None if its data are missing."""
    missing = [name for name in entry.get("data", []) if not (folder / name).exists()]
    if missing:
        print(f"{entry['name']}: skipped, there is no {', '.join(missing)}")
        return None
    picture = folder / f"{entry['name']}.png"
    for command in entry["commands"]:
        words = shlex.split(command)
        assert words[0] == "rayset", command
        last = command is entry["commands"][-1]
        # What is made only to be rendered is made once.
        if not last and "-o" in words and (folder / words[words.index("-o") + 1]).exists():
            continue
        words[0] = str(pathlib.Path(arguments.program).resolve())
        if last:
            width, height = entry.get("size", [960, 640])
            if arguments.small:
                width, height = width // 10, height // 10
            words += ["--size", f"{width}x{height}"]
            words += ["--cache", "cache"] if words[1] == "render" else []
            # The first run builds what the picture needs; what is measured is the picture.
            run(words, folder)
        seconds, peak = run(words, folder)
    width, height = size_of(picture)
    print(f"{entry['name']}: {width}x{height}, {seconds:.1f} s, {peak:.0f} MiB")
    return {"seconds": round(seconds, 1), "mebibytes": round(peak), "width": width, "height": height}


def page(entries, measured):
    lines = [
        "# Gallery",
        "",
        "Made by `docs/gallery/make.py` from [pictures.toml](gallery/pictures.toml), with two threads. Times are of the last",
        "command of each, after what comes before it has been built. They were measured on a shared machine and are",
        "rough; memory is the peak of that command. The",
        "commands are shown without their size; every one takes `--size 960x640`, the statue 640x960.",
        "",
    ]
    for entry in entries:
        lines += [f"## {entry['title']}", "", f"![{entry['title']}](pictures/gallery/{entry['name']}.png)", ""]
        lines += [entry["says"].strip(), ""]
        lines += [f"    {command}" for command in entry["commands"]]
        scenes = [word for command in entry["commands"] for word in command.split() if (HERE / word).suffix == ".json" and (HERE / word).exists()]
        known = measured.get(entry["name"])
        facts = []
        if known:
            facts.append(f"{known['seconds']} s, {known['mebibytes']} MiB")
        facts += [f"scene: [{scene}](gallery/{scene})" for scene in dict.fromkeys(scenes)]
        if "credit" in entry:
            facts.append(f"data: {entry['credit']}")
        lines += ["", "; ".join(facts) + ".", ""]
    PAGE.write_text("\n".join(lines))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--data")
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--work")
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    entries = tomllib.loads((HERE / "pictures.toml").read_text())["picture"]
    measured = json.loads(MEASURED.read_text()) if MEASURED.exists() else {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(arguments.work or temporary)
        folder.mkdir(parents=True, exist_ok=True)
        prepare(folder, arguments.data)
        made = 0
        for entry in entries:
            if arguments.only and entry["name"] not in arguments.only:
                continue
            figures = make(entry, arguments, folder)
            if figures is None:
                continue
            made += 1
            if arguments.write and not arguments.small:
                measured[entry["name"]] = figures
                PICTURES.mkdir(parents=True, exist_ok=True)
                shutil.copy(folder / f"{entry['name']}.png", PICTURES)
    if arguments.write:
        MEASURED.write_text(json.dumps(measured, indent=1, sort_keys=True) + "\n")
        page(entries, measured)
    print(f"{made} pictures")
    if made == 0:
        sys.exit("no picture was made")


main()
