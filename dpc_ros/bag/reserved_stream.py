"""A file with disk space set aside, in which a log can be finished when the disk is full."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path

_FULL = (errno.ENOSPC, errno.EDQUOT)


class ReservedStream:
    """A new file, written straight to the operating system, and a reserve beside it.

    The reserve is an unlinked file: it takes space, has no name, and goes with the process. When
    the disk is full the reserve makes room and writing goes on in it; `full` tells that it is time
    to finish. A write is whole or not at all: one that fails leaves the file as it was before.

    Args:
        path: of the file.

    Attributes:
        full: whether the reserve has been given up.
        closed: whether the file is.

    Raises:
        OSError: the file exists or can't be made.
    """

    def __init__(self, path: Path) -> None:
        self._folder = path.parent
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        self._reserve = -1
        self._position = 0
        self.reserved = 0  # bytes
        self.full = False
        self.closed = False

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._position

    def write(self, data: bytes) -> int:
        """Write all of the data.

        Raises:
            OSError: there is no room even in the reserve, or the device refuses.
        """
        rest = memoryview(data)
        try:
            while rest:
                try:
                    rest = rest[os.write(self._file, rest) :]
                except OSError as error:
                    if error.errno not in _FULL or self._reserve < 0:
                        raise
                    self._give_up_reserve()
        except OSError:
            os.ftruncate(self._file, self._position)
            os.lseek(self._file, self._position, os.SEEK_SET)
            raise
        self._position += len(data)
        return len(data)

    def flush(self) -> None:
        """Do nothing: nothing is held back."""

    def sync(self) -> None:
        """Return when what was written is on the disk.

        Raises:
            OSError: the device refuses.
        """
        os.fsync(self._file)

    def reserve(self, size: int) -> None:
        """Set at least this many bytes aside [bytes].

        Raises:
            OSError: there is no room; what was set aside before has been given up.
        """
        if size <= self.reserved or self.full:
            return
        try:
            if self._reserve < 0:
                with tempfile.TemporaryFile(dir=self._folder) as file:
                    self._reserve = os.dup(file.fileno())
            os.posix_fallocate(self._reserve, 0, size)
        except OSError:
            self._give_up_reserve()
            raise
        self.reserved = size

    def close(self) -> None:
        """Let go of the file and of the reserve."""
        if not self.closed:
            self.closed = True
            os.close(self._file)
            self._close_reserve()

    def _give_up_reserve(self) -> None:
        self.full = True
        self._close_reserve()

    def _close_reserve(self) -> None:
        reserve, self._reserve, self.reserved = self._reserve, -1, 0
        if reserve >= 0:
            os.close(reserve)
