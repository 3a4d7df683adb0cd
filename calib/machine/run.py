"""Which run a file of results is of: one name for all of them, so that those of two runs are not used as one."""

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calib.foundations.errors import OutputError
from calib.foundations.files import LARGEST_JSON, read_bytes
from calib.foundations.json_text import NotJsonError, first_wrong, validated

MODEL_FILE = "model.json"
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
# As many digits tell two runs apart for people.
_SHOWN = 12


class _Named(BaseModel):
    """What is read of ``model.json`` here."""

    model_config = ConfigDict(extra="ignore", strict=True, frozen=True, defer_build=True)

    run: Sha256 | None = None


def run_name(parts: Iterable[bytes]) -> str:
    """Return the name of the run that has found these: the same one for the same bytes."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.hexdigest()


def text_digest(source: bytes) -> str:
    """Return the SHA-256 of a text, which it keeps when its lines are ended as on another system."""
    return hashlib.sha256(source.replace(b"\r\n", b"\n")).hexdigest()


def refuse_other_run(path: Path, run: str | None) -> None:
    """Raise OutputError for a file that is not of the run of ``model.json`` beside it, where there is one.

    ``run``: which the file names. Earlier versions named none, in no file.
    """
    model = path.with_name(MODEL_FILE)
    if not os.path.lexists(model):
        return
    try:
        ours = validated(_Named, read_bytes(model, OutputError, LARGEST_JSON)).run
    except NotJsonError as e:
        raise OutputError(f"{model}: {e}.") from e
    except ValidationError as e:
        raise OutputError(f"{model}: is not a model of this toolkit: {first_wrong(e)}.") from e
    if run != ours:
        raise OutputError(
            f"{path}: names {_said(run)}, and {MODEL_FILE} beside it names {_said(ours)}; "
            "a folder of results is used as one run wrote it."
        )


def _said(run: str | None) -> str:
    return "no run" if run is None else f"the run {run[:_SHOWN]}"
