"""Holds one thread of another process still by ptrace, as a hang would: freeze_thread.py TID SECONDS."""

import ctypes
import os
import sys
import time

PTRACE_SEIZE, PTRACE_INTERRUPT = 0x4206, 0x4207

libc = ctypes.CDLL(None, use_errno=True)
libc.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]


def ptrace(request: int, thread: int) -> None:
    if libc.ptrace(request, thread, None, None) < 0:
        sys.exit(f"ptrace {request:#x} of thread {thread}: {os.strerror(ctypes.get_errno())}")


thread, seconds = int(sys.argv[1]), float(sys.argv[2])
ptrace(PTRACE_SEIZE, thread)
ptrace(PTRACE_INTERRUPT, thread)
print(f"thread {thread} stands still", flush=True)
time.sleep(seconds)
