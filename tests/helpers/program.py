"""Programs in a process of their own."""

import os
import subprocess
import sys

from railrepro import paths


def python(*arguments, folder=None, **environment):
    """A program of this Python that has ended, with what it printed; it finds the checkout."""
    own = os.environ | {"PYTHONPATH": str(paths.ROOT)} | environment
    return subprocess.run([sys.executable, *arguments], cwd=folder, env=own, capture_output=True, text=True)
