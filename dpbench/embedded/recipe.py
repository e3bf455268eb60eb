"""Recipes: where a solver's C comes from, how it is fetched, and what of it is compiled.

A recipe is a folder with `recipe.toml` and `shim.c` or `shim.cpp`, which implements
`runtime/embedded.h`. With a
`generate.py` its function `write_sources` writes C for the QPs that are counted. A folder of a
user's own is the same.
"""

import hashlib
import importlib.util
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path, PurePosixPath
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from dpbench.embedded.toolchain import FOLDER, Target, cache_folder, compile_program
from dpbench.errors import InputError, SituationError, UnknownNameError, format_allowed_names
from dpbench.qp.program import QPSequence
from dpbench.scenario.problem_files import read_toml_as_model

RECIPES = FOLDER / "recipes"
Setting = bool | int | float
Settings = Mapping[str, Setting]
Writer = Callable[[QPSequence, Path, bool, Settings], None]
_Text = Annotated[str, Field(min_length=1)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class PackageTable(_Table):
    """A source distribution: its name, its version, and its hash."""

    name: _Text
    version: _Text
    sha256: Annotated[
        str,
        Field(
            pattern="^[0-9a-f]{64}$",
            json_schema_extra={"allowed": "64 hexadecimal digits (0-9, a-f)"},
        ),
    ]


class RecipeFile(_Table):
    """Contents of a `recipe.toml`."""

    solver: _Text
    """Name in tables; that of the desk's solver where there is one."""
    licence: _Text
    """Version of the solver's C."""
    origin: _Text
    """Origin of the C, in words."""
    start: _Text
    """State that a step starts from."""
    tuned: _Text
    """Settings that were tuned, and the sequences they were tuned on."""
    package: PackageTable | None = None
    library: PackageTable | None = None
    """Source distribution of headers that the package includes."""
    folder: str = ""
    """Contents of the folder that the user names, where no package has the sources."""
    requires: list[str] = []
    """Python packages of the generator, beside those of the extra."""
    sources: list[str] = []
    """Files of the package, or of the recipe's folder without one; with `*` and `?`."""
    include: list[str] = []
    """Folders of headers there, or in the library."""
    defines: list[str] = []
    """Flags of the compiler."""
    float_defines: list[str] | None = None
    """Further flags in single precision; none given: the solver has no single precision."""
    matrices: bool = True
    """True if the matrices may change from step to step."""
    largest: int = 0
    """The most variables that are compiled; 0: any number."""
    generator: str = ""
    """`generate.py`, as a path from the recipe's folder."""
    settings: dict[str, Setting] = {}
    """Settings and their values, which `problem.h` defines as SETTING_NAME."""


class Recipe:
    """A recipe read from its folder; InputError with file and key where that is not one.

    `source` is a folder of the solver's sources, in place of those of a package.
    """

    def __init__(self, folder: Path, source: Path | None = None) -> None:
        self.folder, where = folder.absolute(), folder / "recipe.toml"
        self.source = source.absolute() if source else None
        self.file = read_toml_as_model(where, RecipeFile)
        shims = [self.folder / name for name in ("shim.c", "shim.cpp")]
        self._shims = [path for path in shims if path.is_file()]
        if not self._shims:
            raise InputError(
                str(folder), "shim.c", "no such file", "a shim that implements embedded.h"
            )

    @property
    def solver(self) -> str:
        """Name of the solver whose C the recipe compiles."""
        return self.file.solver

    @property
    def missing(self) -> str:
        """Reason why the recipe cannot be used, such as a missing package; "" if there is none."""
        missing = [name for name in self.file.requires if importlib.util.find_spec(name) is None]
        if self.file.folder and self.source is None:
            return f"add --source {self.solver}=DIR, a folder with {self.file.folder}"
        return f"not installed; run `pip install {' '.join(missing)}`" if missing else ""

    def with_settings(self, given: Settings) -> Settings:
        """Return the recipe's settings with those given; InputError for one that it has not."""
        for key in given:
            if key not in self.file.settings:
                known = list(self.file.settings)
                allowed = format_allowed_names(key, known) if known else "no settings"
                found = "an option that its build recipe does not have"
                raise InputError(f"settings of {self.solver}", key, found, allowed)
        return {**self.file.settings, **given}

    def check(self, sequence: QPSequence, *, single: bool) -> None:
        """Raise InputError if this solver's C cannot take the QPs, or single precision."""
        file, n = self.file, sequence.base.n
        changes = [name for name in ("P", "A", "lb", "ub") if getattr(sequence, name) is not None]
        if single and file.float_defines is None:
            raise InputError(self.solver, "--float", "single precision", "double precision only")
        if changes and not file.matrices:
            verb = "change" if len(changes) > 1 else "changes"
            found = f"{' and '.join(changes)}, which {verb} in {sequence.name}"
            raise InputError(self.solver, "", found, "constant matrices and bounds")
        if file.largest and n > file.largest:
            allowed = f"at most {file.largest}, as its C code grows with the QP"
            raise InputError(self.solver, "variables", n, allowed)

    def compile(
        self,
        sequence: QPSequence,
        target: Target,
        folder: Path,
        *,
        single: bool,
        settings: Settings,
    ) -> Path:
        """Compile the program that solves the QPs of a sequence; `folder` is for what is written.

        InputError and SituationError as `check`, `fetch_sources` and `compile_program` raise them.
        """
        self.check(sequence, single=single)
        if self.missing:
            raise SituationError(self.solver, self.missing)
        file = self.file
        (folder / "problem.h").write_text(_problem_header(sequence, self.with_settings(settings)))
        origins = self._open_origins()
        if file.generator:
            writer = _load_writer(self.folder / file.generator)
            writer(sequence, folder, single, self.with_settings(settings))
        sources = [
            *self._shims,
            *_find(origins[0], file.sources),
            *sorted(folder.rglob("*.c")),
        ]
        include = [self.folder, *(origin / name for origin in origins for name in file.include)]
        defines = [*file.defines]
        if single:
            defines += ["-DEMBEDDED_FLOAT", *(file.float_defines or [])]
        return compile_program(sources, target, written=folder, include=include, defines=defines)

    def _open_origins(self) -> list[Path]:
        """Return the folders of the solver's sources; files to compile are in the first."""
        if self.source is not None:
            return [self.source]
        packages = [table for table in (self.file.package, self.file.library) if table]
        origins = [fetch_sources(table.name, table.version, table.sha256) for table in packages]
        return origins or [self.folder]


def _find(origin: Path, patterns: Iterable[str]) -> list[Path]:
    """Return the files of an origin by patterns, sorted; InputError for one without a file."""
    found: list[Path] = []
    for pattern in patterns:
        files = sorted(origin.glob(pattern))
        if not files:
            raise InputError(
                str(origin), "sources", repr(pattern), "a pattern that matches files there"
            )
        found += files
    return found


def _load_writer(path: Path) -> Writer:
    """Return the function `write_sources` of a recipe's generator."""
    spec = importlib.util.spec_from_file_location(f"dpbench_recipe_{path.parent.name}", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise InputError(str(path), "", "no such file", "a Python file with write_sources")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    writer: Writer = module.write_sources
    return writer


def _problem_header(sequence: QPSequence, settings: Settings) -> str:
    """Return `problem.h`: size of the QPs, finite limits, whether matrices change; settings."""
    qp = sequence.base
    limits = [
        sequence.l,
        sequence.u,
        qp.lb[np.newaxis] if sequence.lb is None else sequence.lb,
        qp.ub[np.newaxis] if sequence.ub is None else sequence.ub,
    ]
    sides = sum(int(np.isfinite(limit).any(axis=0).sum()) for limit in limits)
    changes = any(getattr(sequence, name) is not None for name in ("P", "A", "lb", "ub"))
    numbers: dict[str, object] = {"N": qp.n, "M": qp.m, "BLOCK": qp.block, "CHANGES": int(changes)}
    numbers["SIDES"] = max(sides, 1)
    numbers |= {
        f"SETTING_{key.upper()}": int(value) if isinstance(value, bool) else repr(value)
        for key, value in settings.items()
    }
    return "".join(f"#define {key} {value}\n" for key, value in numbers.items())


def find_recipes(folders: Iterable[Path] = ()) -> dict[str, Recipe]:
    """Return dpbench's recipes, and those of further folders, by the names of their solvers."""
    own = (path.parent for path in sorted(RECIPES.glob("*/recipe.toml")))
    return {recipe.solver: recipe for recipe in map(Recipe, (*own, *folders))}


def select_recipes(
    names: Iterable[str],
    folders: Iterable[Path] = (),
    sources: Mapping[str, Path] | None = None,
) -> list[Recipe]:
    """Return the recipes of named solvers; UnknownNameError for another.

    Without names, all recipes that miss nothing. `sources` are folders by solver.
    """
    known = find_recipes(folders)
    for option, given in (("--source", sources or {}), ("--solver", names)):
        for name in given:
            if name not in known:
                allowed = f"a solver with a build recipe: {format_allowed_names(name, list(known))}"
                raise UnknownNameError(option, "", repr(name), allowed)
    for name, source in (sources or {}).items():
        known[name] = Recipe(known[name].folder, source)
    able = [name for name, recipe in known.items() if not recipe.missing]
    return [known[name] for name in (dict.fromkeys(names) or able)]


def fetch_sources(name: str, version: str, sha256: str) -> Path:
    """Return the unpacked source distribution of a package, fetched by pip if it is not there.

    SituationError with the reason where it cannot be fetched or has another hash.
    """
    store = cache_folder("sources")
    archive, folder = store / f"{name}-{version}.tar.gz", store / f"{name}-{version}-{sha256[:16]}"
    if folder.is_dir():
        return folder
    if not archive.is_file():
        _download(name, version, sha256, store)
    if not archive.is_file():
        raise SituationError(name, f"pip did not fetch {archive.name}")
    found = hashlib.sha256(archive.read_bytes()).hexdigest()
    if found != sha256:
        remedy = f"required: {sha256}; remove the file and run the command again"
        raise SituationError(str(archive), f"found hash {found}; {remedy}")
    _unpack(archive, folder)
    return folder


def _download(name: str, version: str, sha256: str, store: Path) -> None:
    """Have pip fetch one source distribution from the index that it is configured for."""
    remedy = f"put {name}-{version}.tar.gz into {store}, or leave this solver out"
    if importlib.util.find_spec("pip") is None:
        raise SituationError(name, f"its source cannot be fetched without pip: {remedy}")
    with tempfile.TemporaryDirectory() as folder:
        pinned = Path(folder, "pinned.txt")
        pinned.write_text(f"{name}=={version} --hash=sha256:{sha256}\n")
        options = ["--no-deps", "--no-binary", name, "--require-hashes", "--quiet"]
        command = [sys.executable, "-m", "pip", "download", *options]
        done = subprocess.run(
            [*command, "--dest", str(store), "--requirement", str(pinned)],
            check=False,
            capture_output=True,
            text=True,
        )
    if done.returncode:
        errors = [line for line in done.stderr.splitlines() if line.startswith("ERROR:")]
        reason = (errors or ["no message"])[-1].removeprefix("ERROR: ").rstrip(".")
        raise SituationError(name, f"pip cannot fetch its source ({reason}): {remedy}")


def _unpack(archive: Path, folder: Path) -> None:
    """Write the regular files of an archive to `folder`, without its outermost folder."""
    partial = Path(tempfile.mkdtemp(dir=folder.parent))
    with tarfile.open(archive) as files:
        for member in files:
            parts = PurePosixPath(member.name).parts[1:]
            if not member.isreg() or not parts or ".." in parts:
                continue
            stream = files.extractfile(member)
            assert stream is not None
            path = partial.joinpath(*parts)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(stream.read())
    try:
        partial.rename(folder)
    except OSError:  # another process has put it there meanwhile
        shutil.rmtree(partial)
        if not folder.is_dir():
            raise
