"""``python -m rayset`` is the program: Python gives way to it, so that ``--memory`` bounds the whole process."""

import os
import sys

from ._program import path, run

if __name__ == "__main__":
    if os.name == "posix":
        os.execv(path(), ["rayset", *sys.argv[1:]])
    sys.exit(run(sys.argv[1:]))
