"""What of a campaign is finished, kept in a folder."""

import hashlib
import json
import logging
import os
from pathlib import Path

from .. import files
from ..errors import FileFormatError

__all__ = ["CampaignFolder"]

logger = logging.getLogger(__name__)

FORMAT = "gonio-mi campaign"


class CampaignFolder:
    """The folder of a campaign: a description of it, and a record for each task.

    Raises
    ------
    ValueError
        If it holds another campaign, or something else.
    """

    def __init__(self, folder, tasks, incidents):
        self.folder = Path(folder)
        described = {
            "format": FORMAT,
            "variant": tasks[0].variant,
            "incidents": [list(incident) for incident in incidents],
            "specimens": {task.name: _fingerprint(task.specimen) for task in tasks},
            "settings": {k: _text(v) for k, v in sorted(tasks[0].settings.items())},
        }
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / "campaign.json"
        if path.exists():
            _check(path, described)
        else:
            with files.replacing(path) as stream:
                stream.write(json.dumps(described, indent=1).encode())

    def load(self, tasks):
        """Records of the tasks that were finished before, by number.

        A damaged file is reported and left out.
        """
        done = {}
        for task in tasks:
            path = self._path(task)
            if path.exists():
                try:
                    done[task.number] = files.load(path)
                except FileFormatError as error:
                    logger.warning("%s; it is measured again", error)
        return done

    def save(self, task, record):
        """Keep the record of a task."""
        record.save(self._path(task))

    def _path(self, task):
        theta_i, phi_i = task.incidents[0]
        name = f"{task.number:06d}_theta_i_{theta_i:g}_phi_i_{phi_i:g}.npz"
        return self.folder / name


def _check(path, described):
    """Raise ValueError unless the folder holds this very campaign."""
    try:
        found = json.loads(path.read_text())
    except ValueError:
        found = None
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise ValueError(f"folder must hold a campaign or nothing, got {path.parent}")
    for key, own in described.items():
        other = found.get(key)
        if other != own:
            if isinstance(own, dict) and isinstance(other, dict):
                keys = own.keys() | other.keys()
                unlike = sorted(k for k in keys if own.get(k) != other.get(k))
                own, other = ({k: d.get(k) for k in unlike} for d in (own, other))
            raise ValueError(
                f"folder must hold this very campaign, but in {path.parent} its "
                f"{key} are {other!r:.200} instead of {own!r:.200}"
            )


def _text(value):
    """Text of a setting, the same for 1e6 and 1000000."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return repr(float(value) if is_number else value)


def _fingerprint(specimen):
    """Text that tells a specimen from others: for a file, of its content too."""
    if isinstance(specimen, (str, os.PathLike)):
        content = Path(specimen).read_bytes()
        return f"{os.fspath(specimen)} sha256:{hashlib.sha256(content).hexdigest()}"
    return repr(specimen)
