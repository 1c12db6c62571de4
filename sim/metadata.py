"""Component metadata of a PX4: COMPONENT_METADATA names a file on the vehicle, which names the others.

Here the files are the general file and one that describes the parameters; clients read both by MAVLink FTP.
"""

import json
from collections.abc import Sequence
from typing import Any

from skyfolio.sim.ftp import crc32
from skyfolio.sim.parameter_store import REAL32, Parameter
from skyfolio.sim.wire import Unlisted

COMPONENT_METADATA = 397
"""The message's id; pymavlink 2.4.50 does not have it."""
GENERAL, PARAMETERS = "etc/extras/component_general.json", "etc/extras/parameters.json"
_PARAMETER_TYPE = 1
"""COMP_METADATA_TYPE_PARAMETER."""
_URI_BYTES = 100


def metadata_files(parameters: Sequence[Parameter]) -> dict[str, bytes]:
    """Return the files of a vehicle with these parameters."""
    described = [
        {
            "name": parameter.name,
            "type": "Float" if parameter.type == REAL32 else "Int32",
            "default": parameter.default,
            "min": parameter.low,
            "max": parameter.high,
            "shortDesc": f"{parameter.name} of the simulated vehicle",
        }
        for parameter in sorted(parameters)
    ]
    parameter_file = _as_json({"version": 1, "parameters": described})
    general = {
        "version": 1,
        "metadataTypes": [
            {"type": _PARAMETER_TYPE, "uri": f"mftp://{PARAMETERS}", "fileCrc": crc32(parameter_file)},
        ],
    }
    return {GENERAL: _as_json(general), PARAMETERS: parameter_file}


def metadata_message(boot_ms: int, files: dict[str, bytes]) -> Unlisted:
    """Return the COMPONENT_METADATA that names the general file."""
    uri = f"mftp://{GENERAL}".encode()
    return Unlisted(
        COMPONENT_METADATA,
        "COMPONENT_METADATA",
        "uint32_t time_boot_ms uint32_t file_crc char uri ",
        "<II100s",
        (boot_ms, crc32(files[GENERAL]), uri),
        array_bytes=_URI_BYTES,
    )


def _as_json(data: dict[str, Any]) -> bytes:
    return json.dumps(data, separators=(",", ":")).encode()
