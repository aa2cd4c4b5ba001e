"""A program of its own: keeps a file whole whose end is written again with each piece.

replaced_end.py FILE: reads from standard input HEAD, then data and ending; writes data in the place
of the ending before, and the ending after it; answers with an errno, 0: done. A piece that does not
come whole is not written. Where the disk has no room the file is what it was before.
"""

from __future__ import annotations

import os
import struct
import sys
from typing import BinaryIO

#: bytes of data and of the ending
HEAD = struct.Struct("<QQ")
REPLY = struct.Struct("<i")


def _write(file: int, data: bytes, at: int) -> None:
    view = memoryview(data)
    while view:
        written = os.pwrite(file, view, at)
        view, at = view[written:], at + written


def serve(file: int, pieces: BinaryIO, replies: BinaryIO) -> None:
    """Until there are no more."""
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
            # The bytes of the ending before are this file's still.
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
