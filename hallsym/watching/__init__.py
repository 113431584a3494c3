"""Logs over time: whether each still belongs to a calibration, and what changed where it does not.

`watch` fits every log anew from the calibration, `hypotheses` tests what that fit leaves and each of its
parameters, `result` is the control chart that comes of it.
"""

from hallsym.watching.result import Watch, WatchedLog, WatchTest
from hallsym.watching.watch import FALSE_ALARM, watch

__all__ = ["FALSE_ALARM", "Watch", "WatchTest", "WatchedLog", "watch"]
