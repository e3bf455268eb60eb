"""Build hook: compiles the C library of dpbench's own solvers and stores the commit.

`python hatch_build.py` compiles the library in a checkout.
"""

from importlib import util
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

PACKAGE = Path("dpbench")
OWN = PACKAGE / "solvers" / "own"


def load_alone(root: Path, file: Path) -> ModuleType:
    """Load a module by its file, without its package, which needs NumPy."""
    spec = util.spec_from_file_location(file.stem, root / file)
    assert spec is not None and spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def load_compiling(root: Path) -> ModuleType:
    """Load the package's module that compiles."""
    return load_alone(root, OWN / "compiling.py")


try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # as a script it runs without hatchling
    BuildHookInterface = None


if BuildHookInterface is not None:

    class BuildHook(BuildHookInterface):
        """Put the library, for this platform and any Python, and the commit into what is built."""

        def initialize(self, version: str, build_data: dict[str, Any]) -> None:
            """Compile the library, name the wheel after the platform, and store the commit."""
            if version == "editable":
                self.add_library(build_data, None)
                return
            self.folder = TemporaryDirectory(prefix="dpbench-build-")
            self.add_commit(build_data)
            if self.target_name == "wheel":
                # The library in a checkout may be of another compiler than the tag says.
                self.add_library(build_data, Path(self.folder.name))

        def add_library(self, build_data: dict[str, Any], folder: Path | None) -> None:
            """Compile the library into a folder, or in place, and add it to the wheel."""
            compiling = load_compiling(Path(self.root))
            build_data["pure_python"] = False
            build_data["tag"] = compiling.make_wheel_tag()
            if folder is None:
                library = compiling.compile_own_library_if_missing()
                build_data["artifacts"].append(str(OWN / library.name))
            else:
                library = compiling.compile_own_library_if_missing(folder)
                build_data["force_include"][str(library)] = str(OWN / library.name)

        def add_commit(self, build_data: dict[str, Any]) -> None:
            """Add the commit of a checkout; a source distribution has it as a file."""
            git = load_alone(Path(self.root), PACKAGE / "bench" / "record" / "git_commit.py")
            found = git.read_commit(Path(self.root) / PACKAGE)
            if found is not None:
                commit, is_clean = found
                folder = Path(self.folder.name)
                file = git.write_built_commit(folder, commit, is_clean=is_clean)
                build_data["force_include"][str(file)] = str(PACKAGE / file.name)

        def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
            """Remove the folder of the compiled library."""
            if version != "editable":
                self.folder.cleanup()


if __name__ == "__main__":
    print(load_compiling(Path(__file__).parent).compile_own_library_if_missing())
