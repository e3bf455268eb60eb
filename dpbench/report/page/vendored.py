"""Third-party scripts on the page: their versions, licences and hashes.

`make vendored` fetches the version that `vendor/vendored.json` names and writes its hash there.
"""

import hashlib
import json
import subprocess
import tarfile
import tempfile
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

_VENDOR = files("dpbench.report.page").joinpath("vendor")


@dataclass(frozen=True)
class Vendored:
    """Third-party script on the page: its file, licence, npm package and hash."""

    file: str
    package: str
    version: str
    member: str
    licence: str
    licence_file: str
    sha256: str


@cache
def list_vendored_scripts() -> tuple[Vendored, ...]:
    """Return the third-party scripts, in the order the page loads them."""
    return tuple(
        Vendored(**entry) for entry in json.loads(_VENDOR.joinpath("vendored.json").read_text())
    )


@cache
def read_script(entry: Vendored) -> str:
    """Return the text of a third-party script, safe inside an HTML element."""
    text = _VENDOR.joinpath(entry.file).read_text(encoding="utf-8")
    return text.replace("</script", "<\\/script")


def compute_sha256_of_script(entry: Vendored) -> str:
    """Return the SHA-256 of a third-party script's file."""
    return hashlib.sha256(_VENDOR.joinpath(entry.file).read_bytes()).hexdigest()


def download_scripts() -> None:
    """Download every third-party script with npm, and write its hash."""
    vendor = Path(__file__).with_name("vendor")
    entries = []
    for entry in list_vendored_scripts():
        with tempfile.TemporaryDirectory() as folder:
            requested = ["npm", "pack", "--silent", f"{entry.package}@{entry.version}"]
            subprocess.run(requested, cwd=folder, check=True)
            (packed,) = Path(folder).glob("*.tgz")
            with tarfile.open(packed) as archive:
                for member, name in ((entry.member, entry.file), ("LICENSE", entry.licence_file)):
                    taken = archive.extractfile(f"package/{member}")
                    assert taken is not None, f"{entry.package} has no {member}"
                    (vendor / name).write_bytes(taken.read())
        entries.append(asdict(entry) | {"sha256": compute_sha256_of_script(entry)})
    text = json.dumps(entries, indent=2) + "\n"
    (vendor / "vendored.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    download_scripts()
