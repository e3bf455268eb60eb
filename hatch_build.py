"""Compile the C library of dpbench's own solvers: at installation, or `python hatch_build.py`."""

import sysconfig
from importlib import util
from pathlib import Path
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
            library = load_compiling(Path(self.root)).compile_own_library_if_missing()
            platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
            build_data["pure_python"] = False
            build_data["tag"] = f"py3-none-{platform}"
            build_data["artifacts"].append(str(OWN / library.name))


if __name__ == "__main__":
    print(load_compiling(Path(__file__).parent).compile_own_library_if_missing())
