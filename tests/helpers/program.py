"""Programs in separate processes."""

import os
import subprocess
import sys

from railrepro import paths


def python(*arguments, folder=None, **environment):
    """Run a program with this Python and the checkout until it ends; the result has its output."""
    own = os.environ | {"PYTHONPATH": str(paths.ROOT)} | environment
    return subprocess.run([sys.executable, *arguments], cwd=folder, env=own, capture_output=True, text=True)
