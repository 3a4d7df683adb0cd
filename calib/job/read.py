"""From a file to a job, or one clear sentence."""

import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from calib.foundations.errors import JobError
from calib.foundations.files import read_bytes
from calib.job.contradictions import contradictions
from calib.job.schema import Job
from calib.job.sentences import sentence

_LARGEST_JOB = 1_000_000


def read_job(path: Path) -> Job:
    """Read a job file. Raises JobError with the file, the key, the value and what is allowed."""
    source = read_bytes(path, JobError, _LARGEST_JOB)
    try:
        contents = tomllib.loads(source.decode("utf-8-sig"))
    except UnicodeDecodeError as e:
        raise JobError(f"{path}: is not UTF-8 text.") from e
    except RecursionError as e:
        raise JobError(f"{path}: is nested too deep.") from e
    except ValueError as e:  # beside TOMLDecodeError also that of a number with thousands of digits
        reason = str(e) if isinstance(e, tomllib.TOMLDecodeError) else "a number has too many digits"
        raise JobError(f"{path}: is not TOML: {reason}.") from e
    return parse_job(contents, str(path))


def parse_job(contents: dict[str, Any], where: str) -> Job:
    """Return the job of a parsed TOML document. Raises JobError as :func:`read_job` does."""
    try:
        # TOML knows arrays; tuples are how a frozen job keeps them.
        job = Job.model_validate(_tuples(contents))
    except RecursionError as e:
        raise JobError(f"{where}: is nested too deep.") from e
    except ValidationError as e:
        raise JobError(f"{where}: {sentence(e)}") from e
    for contradiction in contradictions(job):
        raise JobError(f"{where}: {contradiction}")
    return job


def _tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _tuples(v) for key, v in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
