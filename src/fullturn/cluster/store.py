"""A folder of results: one Parquet file a part of the table, and what they are the results of."""

from __future__ import annotations

import io
import json
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fullturn.cluster.pairs import PairRow, PairTable
from fullturn.cluster.work import Job
from fullturn.errors import InputError, one_line
from fullturn.io.atomic import make_folder, write_atomic

if TYPE_CHECKING:
    import pyarrow as pa

FORMAT = 1
# An underscore: readers of a whole folder of Parquet files pass over such names.
MANIFEST = "_batch.json"


def result_schema() -> pa.Schema:
    """The columns of the results; docs/batch.md says what they mean."""
    import pyarrow as pa

    # Lists without a fixed length: not every reader of Parquet knows any with one.
    numbers = pa.list_(pa.float64())
    return pa.schema(
        [
            pa.field("id", pa.string(), nullable=False),
            pa.field("source", pa.string(), nullable=False),
            pa.field("target", pa.string(), nullable=False),
            pa.field("status", pa.string(), nullable=False),
            ("error", pa.string()),
            ("T_target_source", numbers),
            ("success_probability", pa.float64()),
            ("overlap_source", pa.float64()),
            ("overlap_target", pa.float64()),
            ("alternatives", pa.int32()),
            ("alternative_T_target_source", pa.list_(numbers)),
            ("alternative_success_probability", numbers),
            ("symmetry", pa.string()),
            ("symmetry_order", pa.int32()),
            ("symmetry_axis", numbers),
            ("covariance", numbers),
            ("method", pa.string()),
            ("notes", pa.list_(pa.string())),
            ("seconds", pa.float64()),
            ("cpu_seconds", pa.float64()),
        ]
    )


@dataclass(frozen=True)
class Tally:
    """How some pairs ended, and why the failed ones did."""

    done: int = 0
    failures: tuple[tuple[str, str], ...] = ()  # id and reason

    def __len__(self) -> int:
        return self.done + len(self.failures)


class Store:
    """The parts of one run, each written whole or not at all.

    Raises:
        InputError: the folder holds results of something else.
        WriteError: the folder cannot be made or written.
    """

    def __init__(
        self, folder: str | os.PathLike[str], table: PairTable, job: Job, *, part_size: int
    ) -> None:
        self.folder = make_folder(folder)
        self._check_manifest(
            {
                "format": FORMAT,
                "fullturn": job.version,
                "pairs": table.count,
                "table": table.digest,
                "folder": job.folder,
                "method": job.method,
                "code": job.code,
                "seed": job.seed,
                "part_size": part_size,
            }
        )

    def tally(self, number: int, rows: Sequence[PairRow]) -> Tally | None:
        """How the pairs of a part ended; None where it isn't there, or isn't whole."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        path = self._path(number)
        if not path.is_file():
            return None
        try:
            found = pq.read_table(path, page_checksum_verification=True)
        except (OSError, pa.ArrowException):
            return None
        if found.schema != result_schema() or found["id"].to_pylist() != [row.id for row in rows]:
            return None
        return _tally(found.select(["id", "status", "error"]).to_pylist())

    def write(self, number: int, results: Sequence[Mapping[str, Any]]) -> Tally:
        """Put the rows of one part on disk.

        Raises:
            WriteError: the folder can no longer be written.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        buffer = io.BytesIO()
        table = pa.Table.from_pylist(list(results), schema=result_schema())
        pq.write_table(table, buffer, write_page_checksum=True)
        write_atomic(self._path(number), buffer.getvalue())
        return _tally(results)

    def _path(self, number: int) -> Path:
        return self.folder / f"part-{number:06d}.parquet"

    def _check_manifest(self, manifest: dict[str, Any]) -> None:
        path, name = self.folder / MANIFEST, one_line(self.folder)
        if next(self.folder.glob("*.parquet"), None) is None:
            write_atomic(path, json.dumps(manifest, indent=1) + "\n")
            return
        if not path.exists():
            raise InputError(
                f"{name}: expected an empty folder or one of these pairs, got one with Parquet "
                f"files and no {MANIFEST}; choose another folder"
            )
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(
                f"{name}: expected results of these pairs, {MANIFEST} cannot be read "
                f"({one_line(error)}); choose another folder"
            ) from error
        found = found if isinstance(found, dict) else {}
        if differing := [key for key in manifest if found.get(key) != manifest[key]]:
            raise InputError(
                f"{name}: expected results of these pairs and settings, got those of others "
                f"({', '.join(differing)} differ); choose another folder"
            )


def _tally(results: Sequence[Mapping[str, Any]]) -> Tally:
    status = Counter(result["status"] for result in results)
    failed = tuple((row["id"], row["error"]) for row in results if row["status"] == "failed")
    return Tally(status["done"], failed)
