"""A program that keeps a file complete while each write replaces the file's ending.

replaced_end.py FILE reads from standard input HEAD, data and ending; writes data in place of the
previous ending, followed by the new one; answers with an errno, or 0. An incomplete input is not
written. If the disk is full, the file is restored. It ends when its input ends; mcap_file.py starts
it with the signals blocked that would end it before.
"""

from __future__ import annotations

import os
import struct
import sys
from typing import BinaryIO

#: Sizes of data and ending in bytes.
HEAD = struct.Struct("<QQ")
REPLY = struct.Struct("<i")


def _write(file: int, data: bytes, at: int) -> None:
    view = memoryview(data)
    while view:
        written = os.pwrite(file, view, at)
        view, at = view[written:], at + written


def serve(file: int, pieces: BinaryIO, replies: BinaryIO) -> None:
    """Writes pieces until the input ends."""
    at, before = 0, b""
    while len(head := pieces.read(HEAD.size)) == HEAD.size:
        data_bytes, ending_bytes = HEAD.unpack(head)
        piece = pieces.read(data_bytes + ending_bytes)
        if len(piece) < data_bytes + ending_bytes:
            return
        number = 0
        try:
            _write(file, piece, at)
            os.ftruncate(file, at + len(piece))
            at, before = at + data_bytes, piece[data_bytes:]
        except OSError as error:
            # Restoring needs no space on the disk, as the file had these bytes before.
            number = error.errno or 1
            _write(file, before, at)
            os.ftruncate(file, at + len(before))
        try:
            replies.write(REPLY.pack(number))
            replies.flush()
        except BrokenPipeError:
            return


if __name__ == "__main__":
    serve(os.open(sys.argv[1], os.O_WRONLY), sys.stdin.buffer, sys.stdout.buffer)
