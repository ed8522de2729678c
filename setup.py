"""What pyproject.toml cannot say: the inputs in data/ are part of a built package, as railrepro/data.

A checkout reads data/ itself, so an editable installation has no copy.
"""

from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

INPUTS = ("LICENSE", "*.toml", "tuned/*/*.json")


class BuildWithInputs(build_py):
    """Copies the inputs, too."""

    def _inputs(self) -> dict[str, str]:
        """Files to write, below build_lib, and where they come from."""
        files = [file for pattern in INPUTS for file in sorted(Path("data").glob(pattern))]
        return {str(Path(self.build_lib, "railrepro", file)): str(file) for file in files}

    def run(self):
        super().run()
        if not self.editable_mode:
            for target, source in self._inputs().items():
                self.mkpath(str(Path(target).parent))
                self.copy_file(source, target, preserve_mode=False)

    def get_outputs(self, include_bytecode=True):
        return super().get_outputs(include_bytecode) + ([] if self.editable_mode else list(self._inputs()))


setup(cmdclass={"build_py": BuildWithInputs})
