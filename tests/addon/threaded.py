# SPDX-License-Identifier: GPL-3.0-or-later
"""Stands in for another process, which would not have what a test has replaced in this one."""

import threading


class Threaded:
    """As `child.Child`, but in a thread."""

    object = None

    def __init__(self, kind, *args, heard, **_options):
        self._object, self._heard = kind(*args, self._report), heard
        self._news, self._ended, self._thread = [], False, None

    def _report(self, news):
        if self._ended:
            raise RuntimeError("ended")
        self._news.append(news)

    def call(self, name, *args):
        answer = []

        def work():
            try:
                answer.extend([getattr(self._object, name)(*args), None])
            except BaseException as error:
                answer.extend([None, error])

        self._thread = threading.Thread(target=work, name="dynamorph stand-in", daemon=True)
        self._thread.start()
        while self._thread.is_alive():
            self._hear()
            yield
            self._thread.join(0.005)
        self._hear()
        result, error = answer
        if error:
            raise error
        return result

    def _hear(self):
        while self._news:
            self._heard(self._news.pop(0))

    def end(self):
        """The thread ends at its next report; a process would at once."""
        self._ended = True

    leave = end
