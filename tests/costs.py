# SPDX-License-Identifier: GPL-3.0-or-later
"""What an action costs, for comparison with another one in the same run: how busy the machine is hardly counts."""

import time


def cost(action, times: int = 5) -> float:
    """Processor seconds of this thread: the least of several times."""
    found = []
    for _ in range(times):
        began = time.thread_time()
        action()
        found.append(time.thread_time() - began)
    return min(found)
