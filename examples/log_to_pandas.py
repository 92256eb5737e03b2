"""Read a log into pandas: `python examples/log_to_pandas.py flight.mcap` (in a clone: `pip install .[pandas]`)."""

import sys

import pandas as pd

from flightstack.api import read_log


def truth_of(path: str) -> pd.DataFrame:
    """True position and velocity (NED), one row each 4 ms, indexed by seconds."""
    truth = read_log(path).tables["/truth"]
    columns = {}
    for name in ("pos_ned_m", "vel_ned_mps"):
        for axis, letter in enumerate("ned"):
            columns[f"{name.split('_')[0]}_{letter}"] = truth[name][:, axis]
    return pd.DataFrame(columns, index=pd.Index(truth.t_us * 1e-6, name="time_s"))


if __name__ == "__main__":
    frame = truth_of(sys.argv[1])
    print(frame.describe().loc[["min", "mean", "max"]].round(3))
