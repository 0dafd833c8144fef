"""The files that this process opens, as the kernel reports them, whichever library opens them (fanotify of Linux 5.13 or newer).

Python's audit hook sees only what Python opens: HDF5, OpenCV and simulators open files in C.
"""

from __future__ import annotations

import ctypes
import os
import struct
import sys

# Most folders that are watched, and files in them. An environment has far fewer.
MOST_FOLDERS = 10_000
MOST_FILES = 100_000
# Folders that contain no files of an environment.
SKIPPED = frozenset({".git", "__pycache__", "node_modules", "site-packages"})

# From linux/fanotify.h and fcntl.h.
FAN_MODIFY, FAN_CLOSE_WRITE, FAN_OPEN, FAN_Q_OVERFLOW, FAN_EVENT_ON_CHILD = 0x2, 0x8, 0x20, 0x4000, 0x0800_0000
FAN_CLOEXEC, FAN_NONBLOCK, FAN_REPORT_DIR_FID, FAN_REPORT_NAME = 0x1, 0x2, 0x400, 0x800
FAN_MARK_ADD, FAN_EVENT_INFO_TYPE_DFID_NAME, AT_FDCWD, AT_SYMLINK_FOLLOW = 0x1, 2, -100, 0x400
MOST_HANDLE = 128
EVENT, INFO, HANDLE = struct.Struct("=IBBHQii"), struct.Struct("=BBH8s"), struct.Struct("=Ii")

# A file in a folder: the folder's handle, and the name.
Place = tuple[bytes, str]


class Watch:
    """Watches the files below a folder, also those that links in it name. `complete` is false where the kernel or the file system cannot."""

    def __init__(self, folder: str):
        self.folder = folder
        self.complete = False
        self._descriptor = -1
        # The folders by their handles, and files elsewhere that links name.
        self._folders: dict[bytes, str] = {}
        self._links: dict[Place, str] = {}
        if sys.platform == "linux":
            self._start()

    def _start(self) -> None:
        library = ctypes.CDLL(None, use_errno=True)
        if not hasattr(library, "fanotify_init"):
            return
        library.fanotify_mark.argtypes = [ctypes.c_int, ctypes.c_uint, ctypes.c_uint64, ctypes.c_int, ctypes.c_char_p]
        flags = FAN_CLOEXEC | FAN_NONBLOCK | FAN_REPORT_DIR_FID | FAN_REPORT_NAME
        self._descriptor = library.fanotify_init(flags, os.O_RDONLY)
        self.complete = self._descriptor >= 0 and self._add_all(library)

    def _add_all(self, library: ctypes.CDLL) -> bool:
        """Watch all folders. Returns whether that worked."""
        root, seen = os.path.realpath(self.folder), 0
        for folder, folders, files in os.walk(self.folder, followlinks=True):
            handle = self._add(library, folder)
            if handle is None:
                return False
            if handle in self._folders:
                # A link to a folder that is watched already, such as one above it.
                folders.clear()
                continue
            self._folders[handle] = folder
            # Links within the folder are not followed, so that a file has one name. A link to a folder above it would never end.
            folders[:] = sorted(name for name in folders if name not in SKIPPED and self._is_own(os.path.join(folder, name), root))
            seen += len(files)
            if seen > MOST_FILES:
                return False
            for link in (path for path in (os.path.join(folder, name) for name in sorted(files)) if os.path.islink(path)):
                target = os.path.realpath(link)
                if os.path.isfile(target) and not target.startswith(root + os.sep):
                    handle = self._add(library, os.path.dirname(target))
                    if handle is None:
                        return False
                    self._links[handle, os.path.basename(target)] = link
            if len(self._folders) > MOST_FOLDERS:
                return False
        return True

    @staticmethod
    def _is_own(folder: str, root: str) -> bool:
        """Whether a folder is walked: unless it is a link to a folder within or above the root."""
        if not os.path.islink(folder):
            return True
        target = os.path.realpath(folder)
        return os.path.commonpath([target, root]) not in (target, root)

    def _add(self, library: ctypes.CDLL, folder: str) -> bytes | None:
        """Watch the files in a folder. Returns its handle."""
        path = os.fsencode(folder)
        events = FAN_OPEN | FAN_MODIFY | FAN_CLOSE_WRITE | FAN_EVENT_ON_CHILD
        handle = ctypes.create_string_buffer(HANDLE.size + MOST_HANDLE)
        HANDLE.pack_into(handle, 0, MOST_HANDLE, 0)
        if library.fanotify_mark(self._descriptor, FAN_MARK_ADD, events, AT_FDCWD, path) != 0:
            return None
        if library.name_to_handle_at(AT_FDCWD, path, handle, ctypes.byref(ctypes.c_int()), AT_SYMLINK_FOLLOW) != 0:
            return None
        return handle.raw[: HANDLE.size + HANDLE.unpack_from(handle)[0]]

    def end(self) -> tuple[set[str], set[str]]:
        """Stop. Returns the files that this process has opened, and those of them that it has written."""
        opened: set[str] = set()
        written: set[str] = set()
        while self._descriptor >= 0:
            try:
                text = os.read(self._descriptor, 1 << 16)
            except BlockingIOError:
                os.close(self._descriptor)
                self._descriptor = -1
                break
            self._read(text, opened, written)
        return opened, written

    def _read(self, text: bytes, opened: set[str], written: set[str]) -> None:
        at = 0
        while at + EVENT.size <= len(text):
            size, _, _, head, mask, _, process = EVENT.unpack_from(text, at)
            if mask & FAN_Q_OVERFLOW:
                self.complete = False
            # The events of other processes have their numbers, or 0.
            elif process == os.getpid():
                path = self._path(text[at + head : at + size])
                if path is not None:
                    (opened if mask & FAN_OPEN else written).add(path)
                    if mask & (FAN_MODIFY | FAN_CLOSE_WRITE):
                        written.add(path)
            at += size

    def _path(self, information: bytes) -> str | None:
        kind, _, size, _ = INFO.unpack_from(information)
        if kind != FAN_EVENT_INFO_TYPE_DFID_NAME:
            return None
        end = INFO.size + HANDLE.size + HANDLE.unpack_from(information, INFO.size)[0]
        handle, name = information[INFO.size : end], os.fsdecode(information[end:size].split(b"\0")[0])
        folder = self._folders.get(handle)
        return os.path.join(folder, name) if folder is not None else self._links.get((handle, name))
