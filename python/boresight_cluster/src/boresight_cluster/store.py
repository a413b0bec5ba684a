"""Where results go: a folder, or a bucket. An object is put if it is absent, whole or not at all, and never replaced by other bytes."""

import contextlib
import fcntl
import hashlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

from .config import Cluster
from .errors import ClusterError, NeverError

CHUNK = 1 << 20
# So often in a row a folder may be removed by others while a file is begun in it.
MAX_REMOVED = 100
# From here on an object of a bucket is sent in parts; it is then looked for before and not while it is put.
MAX_ONE_PUT_BYTES = 64 << 20


def sha256_of(chunks: Iterator[bytes]) -> str:
    """SHA-256 of bytes that come piece by piece."""
    sum = hashlib.sha256()
    for chunk in chunks:
        sum.update(chunk)
    return sum.hexdigest()


def chunks_of(path: Path) -> Iterator[bytes]:
    """The bytes of a file."""
    with open(path, "rb") as file:
        while chunk := file.read(CHUNK):
            yield chunk


class Folder:
    """A folder that every machine sees. What is in the making is called .boresight-*.partial and locked, as the program does."""

    def __init__(self, path: Path):
        self.path = path

    def __str__(self) -> str:
        return str(self.path)

    def place(self, name: str) -> str:
        """What a user calls an object."""
        return str(self.path / name)

    def names(self, prefix: str) -> dict[str, int]:
        """Objects below a prefix that ends in `/`, with their bytes."""
        found = {}
        for path in (self.path / prefix).rglob("*"):
            try:
                if path.is_file() and not path.name.endswith(".partial"):
                    found[path.relative_to(self.path).as_posix()] = path.stat().st_size
            except FileNotFoundError:  # another driver has just taken it away
                continue
        return found

    def read(self, name: str, bytes_: int | None = None) -> bytes | None:
        """The bytes of an object, or so many from its beginning; None: it is not there."""
        try:
            with open(self.path / name, "rb") as file:
                return file.read(bytes_)
        except FileNotFoundError:
            return None

    def sha256(self, name: str) -> str:
        """The hash of an object that is there."""
        return sha256_of(chunks_of(self.path / name))

    def _partial(self, folder: Path) -> tuple[int, Path]:
        """A locked file in the making."""
        for _ in range(MAX_REMOVED):
            # A folder that goes between two looks of `mkdir` is told to exist as something else.
            with contextlib.suppress(FileNotFoundError, FileExistsError):
                return self._partial_in(folder)
        return self._partial_in(folder)

    def _partial_in(self, folder: Path) -> tuple[int, Path]:
        """The same, or an error if another process has just removed the folder, which was empty. What a killed process left has a free lock and goes."""
        folder.mkdir(parents=True, exist_ok=True)
        for left in folder.glob(".boresight-*.partial"):
            try:
                with open(left, "rb") as file:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    left.unlink(missing_ok=True)
            except OSError:  # in use, gone, a folder, or a file system without locks
                continue
        while True:
            path = folder / f".boresight-{secrets.token_hex(6)}.partial"
            file = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
            try:
                fcntl.flock(file, fcntl.LOCK_EX)
            except OSError:
                return file, path
            if path.exists():  # else another process took it for a leftover before it was locked
                return file, path
            os.close(file)

    def _written(self, name: str, chunks: Iterator[bytes]) -> tuple[int, Path, Path]:
        """Writes an object under a name of its own and waits for the disk."""
        target = self.path / name
        file, path = self._partial(target.parent)
        try:
            for chunk in chunks:
                while chunk:
                    chunk = chunk[os.write(file, chunk) :]
            os.fsync(file)
        except BaseException:
            path.unlink(missing_ok=True)
            os.close(file)
            raise
        return file, path, target

    def put_absent(self, name: str, source: Path) -> bool:
        """Puts a file whole, unless something of that name is there: then False."""
        if (self.path / name).exists():
            return False
        file, path, target = self._written(name, chunks_of(source))
        try:
            os.link(path, target)
        except FileExistsError:
            return False
        except OSError:  # a file system without hard links: two that put at once put the same bytes
            if target.exists():
                return False
            os.rename(path, target)
        finally:
            path.unlink(missing_ok=True)
            os.close(file)
            _sync_folder(target.parent)
        return True

    def write(self, name: str, data: bytes) -> None:
        """Writes an object, over an older one."""
        file, path, target = self._written(name, iter([data]))
        os.rename(path, target)
        os.close(file)
        _sync_folder(target.parent)

    def remove(self, name: str) -> None:
        """Removes an object, and folders that are then empty."""
        path = self.path / name
        try:
            path.unlink()
        except FileNotFoundError:  # who removes the last object of a folder removes the folder
            return
        for folder in path.parents:
            if folder == self.path:
                break
            try:
                folder.rmdir()
            except OSError:
                break


def _sync_folder(folder: Path) -> None:
    """Waits until the disk has the names of a folder."""
    try:
        file = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(file)
    except OSError:  # not every file system does
        pass
    finally:
        os.close(file)


class Bucket:
    """A prefix of S3, or of what `obstore` reaches besides (gs://, az://)."""

    def __init__(self, url: str, endpoint: str):
        try:
            import obstore
            from obstore import exceptions, store
        except ImportError as error:
            raise NeverError(f"{url}: needs the package obstore: pip install boresight-cluster[s3]") from error
        self.url, self.obstore, self.errors = url.rstrip("/"), obstore, exceptions
        options = {"endpoint": endpoint} if endpoint else {}
        try:
            self.store = store.from_url(self.url, client_options={"allow_http": endpoint.startswith("http://")}, **options)
        except exceptions.BaseError as error:
            raise NeverError(f"{url}: is no place to write to ({error}); give s3://BUCKET/PREFIX") from error

    def __str__(self) -> str:
        return self.url

    def place(self, name: str) -> str:
        """What a user calls an object."""
        return f"{self.url}/{name}"

    def _call(self, name: str, call):
        try:
            return call()
        except (FileNotFoundError, self.errors.AlreadyExistsError):
            raise
        except self.errors.BaseError as error:
            said = " ".join(str(error).split())[:300]
            raise ClusterError(
                f"{self.place(name)}: the store refuses ({said}); look at the credentials of the environment and at [store]"
            ) from error

    def names(self, prefix: str) -> dict[str, int]:
        """Objects below a prefix that ends in `/`, with their bytes."""
        batches = self._call(prefix, lambda: list(self.obstore.list(self.store, prefix=prefix, chunk_size=1000)))
        return {one["path"]: one["size"] for batch in batches for one in batch}

    def read(self, name: str, bytes_: int | None = None) -> bytes | None:
        """The bytes of an object, or so many from its beginning; None: it is not there."""
        try:
            if bytes_:
                return self._call(name, lambda: bytes(self.obstore.get_range(self.store, name, start=0, length=bytes_)))
            return self._call(name, lambda: bytes(self.obstore.get(self.store, name).bytes()))
        except FileNotFoundError:
            return None

    def sha256(self, name: str) -> str:
        """The hash of an object that is there."""
        return self._call(name, lambda: sha256_of(bytes(chunk) for chunk in self.obstore.get(self.store, name).stream(min_chunk_size=CHUNK)))

    def put_absent(self, name: str, source: Path) -> bool:
        """Puts a file whole, unless something of that name is there: then False."""
        try:
            if source.stat().st_size <= MAX_ONE_PUT_BYTES:
                self._call(name, lambda: self.obstore.put(self.store, name, source, mode="create"))
                return True
            try:
                self._call(name, lambda: self.obstore.head(self.store, name))
                return False
            except FileNotFoundError:
                self._call(name, lambda: self.obstore.put(self.store, name, source))
                return True
        except self.errors.AlreadyExistsError:
            return False

    def write(self, name: str, data: bytes) -> None:
        """Writes an object, over an older one."""
        self._call(name, lambda: self.obstore.put(self.store, name, data))

    def remove(self, name: str) -> None:
        """Removes an object; one that is not there is no fault."""
        try:
            self._call(name, lambda: self.obstore.delete(self.store, name))
        except FileNotFoundError:
            pass


Store = Folder | Bucket


def open_store(cluster: Cluster) -> Store:
    """The target of CLUSTER.toml."""
    to = cluster.work.to
    if "://" in to and not to.startswith("file://"):
        return Bucket(to, cluster.store.endpoint)
    return Folder(cluster.beside(to.removeprefix("file://")))


def keep(store: Store, name: str, source: Path) -> None:
    """Puts a file; what is there already must have the same bytes and stays as it is."""
    if not store.put_absent(name, source) and store.sha256(name) != sha256_of(chunks_of(source)):
        raise NeverError(f"{store.place(name)}: is there with other bytes and is not overwritten; remove it, and it is made anew")
