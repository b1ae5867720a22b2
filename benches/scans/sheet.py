#!/usr/bin/env python3
"""First pictures of files by two programs, side by side, on one sheet: what has become better, and what worse.

    pip install pillow
    benches/scans/sheet.py BEFORE AFTER FOLDER SHEET.jpg FILE...

BEFORE and AFTER are programs of rayset; pictures as large as people see them are left in FOLDER.
"""

import argparse
import os
import subprocess

from PIL import Image, ImageDraw

SIZE, SMALL = (960, 640), (288, 192)
PAIRS_ACROSS = 3
CAPTION, GAP = 16, 6


def picture(program, path, shot, cache):
    """The first picture of a file, small; made in a cache of the program's own."""
    command = [program, "render", path, "-o", shot, "--size", "{}x{}".format(*SIZE)]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"XDG_CACHE_HOME": cache})
    if done.returncode != 0:
        print(f"{path}: {done.stderr.strip().splitlines()[-1]}")
        return Image.new("RGB", SMALL, "white")
    return Image.open(shot).convert("RGB").resize(SMALL, Image.Resampling.LANCZOS)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before")
    parser.add_argument("after")
    parser.add_argument("folder")
    parser.add_argument("sheet")
    parser.add_argument("files", nargs="+")
    given = parser.parse_args()
    rows = -(-len(given.files) // PAIRS_ACROSS)
    pair = (2 * SMALL[0] + GAP, SMALL[1] + CAPTION + GAP)
    sheet = Image.new("RGB", (PAIRS_ACROSS * (pair[0] + GAP) - GAP, rows * pair[1]), "white")
    draw = ImageDraw.Draw(sheet)
    for number, path in enumerate(given.files):
        x, y = number % PAIRS_ACROSS * (pair[0] + GAP), number // PAIRS_ACROSS * pair[1]
        name = os.path.basename(path)
        for side, program in enumerate((given.before, given.after)):
            shot = os.path.join(given.folder, f"{name}-{('before', 'after')[side]}.png")
            small = picture(program, path, shot, os.path.join(given.folder, f"cache-{side}"))
            sheet.paste(small, (x + side * SMALL[0], y + CAPTION))
        draw.text((x + 2, y + 2), name, fill="black")
    sheet.save(given.sheet, quality=80)


if __name__ == "__main__":
    main()
