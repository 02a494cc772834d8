"""Which bytes something was made from: hashes of files, and the commit of a working tree."""

from __future__ import annotations

import hashlib
import subprocess
from collections.abc import Iterable
from pathlib import Path

from fullturn.errors import ReadError


def sha256_of_file(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise ReadError(
            f"expected a readable file at {path}: {error.strerror}; check the path"
        ) from error


def sha256_of_files(paths: Iterable[Path], *, root: Path) -> str:
    """SHA-256 over files of a folder: their paths below `root` and their own hashes, by path."""
    lines = (f"{sha256_of_file(path)}  {path.relative_to(root).as_posix()}\n" for path in paths)
    return hashlib.sha256("".join(sorted(lines)).encode()).hexdigest()


def working_tree_commit() -> str | None:
    """The commit of the working tree that this package lies in, None where it is installed.

    "-dirty" at the end: files of the package differ from the commit, or are new.
    """
    package = Path(__file__).resolve().parents[1]
    tree = package.parents[1]
    # A package installed below someone else's repository has nothing to do with its commits.
    if not (tree / ".git").exists() or package != tree / "src" / package.name:
        return None

    def git(*arguments: str) -> str:
        command = ["git", "--no-optional-locks", "-C", str(tree), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=30)
        return done.stdout.strip()

    try:
        changed = git("status", "--porcelain", "--", str(package))
        return git("rev-parse", "HEAD") + ("-dirty" if changed else "")
    except (OSError, subprocess.SubprocessError):
        return None
