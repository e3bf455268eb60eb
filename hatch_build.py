"""Compile the C library of dpbench's own solvers: at installation, or `python hatch_build.py`."""

from importlib import util
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

OWN = Path("dpbench", "solvers", "own")


def load_compiling(root: Path) -> ModuleType:
    """Load the package's module that compiles, without the package, which needs NumPy."""
    spec = util.spec_from_file_location("compiling", root / OWN / "compiling.py")
    assert spec is not None and spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # as a script it runs without hatchling
    BuildHookInterface = None


if BuildHookInterface is not None:

    class CompileHook(BuildHookInterface):
        """Put the library into wheels and editable installations, for this platform, any Python."""

        def initialize(self, version: str, build_data: dict[str, Any]) -> None:
            """Compile the library and name the wheel after the platform."""
            compiling = load_compiling(Path(self.root))
            build_data["pure_python"] = False
            build_data["tag"] = compiling.make_wheel_tag()
            if version == "editable":
                library = compiling.compile_own_library_if_missing()
                build_data["artifacts"].append(str(OWN / library.name))
                return
            # The library in a checkout may be of another compiler than the tag says.
            self.folder = TemporaryDirectory(prefix="dpbench-wheel-")
            library = compiling.compile_own_library_if_missing(Path(self.folder.name))
            build_data["force_include"][str(library)] = str(OWN / library.name)

        def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
            """Remove the folder of the compiled library."""
            if version != "editable":
                self.folder.cleanup()


if __name__ == "__main__":
    print(load_compiling(Path(__file__).parent).compile_own_library_if_missing())
