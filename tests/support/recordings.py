"""Reads recordings as docs/recording.md describes."""
import json

import numpy as np


def rows_of(file):
    """Returns a recording's ticks as an array of records."""
    with open(file, "rb") as opened:
        head = json.loads(opened.readline())
    rows = np.fromfile(file, [tuple(field) for field in head["dtype"]], offset=head["offset"])
    return rows[rows["tick"] > 0]
