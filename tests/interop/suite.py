"""Trackers in C++, Python and shell under `boresight test`, and its JUnit file read by junitparser: python suite.py BORESIGHT FOLDER."""

import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from junitparser import JUnitXml

ROOT = Path(__file__).resolve().parents[2]


def tested(boresight: Path, name: str, folder: Path) -> JUnitXml:
    """Runs an example's suite with its words for the program replaced; its JUnit file, which must be read whole."""
    suite = folder / f"{name}.toml"
    text = (ROOT / "examples/trackers" / f"{name}.toml").read_text()
    text = text.replace('"boresight"]', f'"{boresight}"]').replace("examples/trackers/", f"{ROOT}/examples/trackers/")
    suite.write_text(text.replace("target/centroids", str(folder / "centroids")))
    (folder / "scene.toml").write_text((ROOT / "examples/trackers/scene.toml").read_text())
    junit = folder / f"{name}.xml"
    run = subprocess.run([boresight, "test", suite, "--junit", junit, "-o", folder / name, "--force", "--quiet"], capture_output=True, text=True)
    assert run.returncode == 0, f"{name}: exit code {run.returncode}\n{run.stdout}{run.stderr}"
    return JUnitXml.fromfile(str(junit))


def check_cpp(boresight: Path, folder: Path) -> None:
    """The detector in C++ is compiled and meets its requirements."""
    compiler = os.environ.get("CXX", "c++")
    subprocess.run(
        [compiler, "-O2", "-std=c++17", "-Wall", "-Wextra", "-Werror", ROOT / "examples/trackers/centroids.cpp", "-o", folder / "centroids"],
        check=True,
    )
    report = tested(boresight, "cpp", folder)
    assert report.tests == 4 and report.failures == 0, (report.tests, report.failures)


def check_python(boresight: Path, folder: Path) -> None:
    """The tracker in Python meets its requirements."""
    assert tested(boresight, "python", folder).tests == 2


def check_shell(boresight: Path, folder: Path) -> None:
    """The tracker behind a shell script meets its requirements."""
    assert tested(boresight, "shell", folder).tests == 1


def check_failures_are_read(boresight: Path, folder: Path) -> None:
    """A requirement that is not met is a failure to junitparser, with the value in its output; the file has what Jenkins' schema knows, and no more."""
    suite = folder / "failing.toml"
    suite.write_text(
        'format = "boresight-suite/1"\n[[case]]\nname = "a & <b>"\nscene = "scene.toml"\nframes = 20\n'
        '[[case.require]]\nmetric = "centroids.error_px.rms"\nat_most = 1e-6\n[[case.require]]\nmetric = "acquisition.correct_rate"\nat_least = 0.86\nlevel = "design"\n'
        '[[case.require]]\nmetric = "centroids.error_px.rms"\nat_most = 1e-5\nlevel = "stretch"\n'
    )
    junit = folder / "failing.xml"
    run = subprocess.run([boresight, "test", suite, "--junit", junit, "--quiet"], capture_output=True, text=True)
    assert run.returncode == 3, run.stderr
    report = JUnitXml.fromfile(str(junit))
    assert report.failures == 1, report.failures
    case = next(iter(next(iter(report))))
    told = dict(line.split(" = ", 1) for line in case.system_out.splitlines())
    assert set(told) >= {"value", "lower", "upper", "frames", "verdict"} and float(told["value"]) > 0, told
    # junit-10.xsd of Jenkins' xunit plugin: the attributes and children that it knows.
    known = {
        "testsuites": ({"name", "time", "tests", "failures", "errors"}, {"testsuite"}),
        "testsuite": (
            set("name tests failures errors group time skipped timestamp hostname id package file log url".split()),
            {"testsuite", "properties", "testcase", "system-out", "system-err"},
        ),
        "testcase": ({"name", "time", "classname", "group"}, {"skipped", "error", "failure", "system-out", "system-err"}),
        "properties": (set(), {"property"}),
        "property": ({"name", "value"}, set()),
        "failure": ({"type", "message"}, set()),
        "skipped": ({"type", "message"}, set()),
        "system-out": (set(), set()),
    }
    seen = set()
    for element in ElementTree.parse(junit).iter():
        attributes, children = known[element.tag]
        seen.add(element.tag)
        assert set(element.attrib) <= attributes, (element.tag, element.attrib)
        assert {child.tag for child in element} <= children, (element.tag, [child.tag for child in element])
        assert element.tag != "testsuite" or {"name", "tests", "failures", "errors"} <= set(element.attrib), element.attrib
    assert seen == set(known), set(known) - seen


CHECKS = [check_cpp, check_python, check_shell, check_failures_are_read]


def main() -> None:
    """Runs all checks."""
    boresight, folder = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    failed = 0
    for check in CHECKS:
        try:
            check(boresight, folder)
        except Exception as error:
            failed += 1
            print(f"{check.__name__}: {error}", file=sys.stderr)
    print(f"{len(CHECKS) - failed} passed, {failed} failed")
    sys.exit(failed > 0)


main()
