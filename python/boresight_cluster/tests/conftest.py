"""What the tests share. A test that is skipped counts as failed, and the last line is `N passed, N failed`, as for every other part of the checks."""

import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import kit
import pytest


def pytest_terminal_summary(terminalreporter, exitstatus):
    """The line that is summed up by whoever runs all checks."""
    stats = terminalreporter.stats
    failed = sum(len(stats.get(kind, [])) for kind in ("failed", "error", "skipped", "xfailed"))
    terminalreporter.write_line(f"{len(stats.get('passed', []))} passed, {failed + (exitstatus > 1)} failed")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Nothing is left out in silence."""
    report = yield
    if report.skipped:
        report.outcome, report.longrepr = "failed", f"{item.nodeid} was skipped"
    return report


@pytest.fixture(scope="session")
def reference(tmp_path_factory) -> dict[str, str]:
    """Hashes of the dataset of `kit.RECIPE`, made by one process of the program."""
    folder = tmp_path_factory.mktemp("reference")
    kit.recipe(folder)
    subprocess.run([kit.program(), "dataset", "recipe.toml", "-o", "set", "--quiet"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    hashes = kit.hashes(folder / "set")
    assert len([name for name in hashes if name.endswith(".tar")]) == kit.SHARDS
    shutil.rmtree(folder)
    return hashes


@pytest.fixture(scope="session")
def s3(tmp_path_factory) -> str:
    """An S3 server on loopback, and its address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    log = open(tmp_path_factory.mktemp("moto") / "log", "wb")
    server = subprocess.Popen([sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)], stdout=log, stderr=log)
    address = f"http://127.0.0.1:{port}"
    for _ in range(300):
        try:
            urllib.request.urlopen(urllib.request.Request(f"{address}/sky", method="PUT"), timeout=5)
            break
        except OSError:
            assert server.poll() is None, f"the S3 server ended: {Path(log.name).read_text()}"
            time.sleep(0.1)
    yield address
    server.terminate()
    server.wait()


@pytest.fixture
def work(tmp_path) -> Path:
    """A folder with the recipe and a place for scratch folders, which has to be empty afterwards."""
    kit.recipe(tmp_path)
    (tmp_path / "scratch").mkdir()
    return tmp_path
