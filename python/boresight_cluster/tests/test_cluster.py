"""The same bytes whatever is killed, by however many workers and drivers; what cannot be made is named, tried once, and stops nothing else."""

import json
import os
import re
import shutil
import signal
import stat
import subprocess
import threading
import time
from pathlib import Path

import kit
import pytest


def no_scratch(work: Path) -> bool:
    """Whether nothing is left of the tasks."""
    return not list((work / "scratch").iterdir())


def wrapped(work: Path, name: str, lines: str) -> str:
    """A program around the program, which notes every shard that it is asked for in `asked`."""
    path = work / name
    path.write_text(f'#!/bin/bash\ncase " $* " in *" --shard "*) echo "$*" >> "{work}/asked";; esac\n{lines}\nexec "{kit.program()}" "$@"\n')
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def asked(work: Path, number: int) -> int:
    """How often a shard was asked for."""
    return len(re.findall(rf"--shard {number}/", (work / "asked").read_text()))


def test_one_worker_makes_what_the_program_makes(work, reference):
    code, out, err = kit.ran(kit.cluster(work, "set", workers=1))
    assert code == 0, err
    assert f"{kit.SHARDS} of {kit.SHARDS} done" in out
    assert kit.hashes(work / "set") == reference
    assert no_scratch(work) and not (work / ".boresight-cluster").exists()
    # Nothing is made twice.
    begun = time.monotonic()
    code, out, err = kit.ran(work / "cluster.toml")
    assert code == 0 and f"{kit.SHARDS} of {kit.SHARDS} are there, 0 to do" in err, err
    assert time.monotonic() - begun < 30


def test_kills_change_no_byte_in_a_folder(work, reference):
    code, err, kills, _ = kit.chaos(work, "set", 1)
    assert code == 0, err
    assert len(kills) >= 10 and set(kills) == set(kit.KINDS), kills
    assert kit.hashes(work / "set") == reference


def test_kills_change_no_byte_in_a_bucket(work, reference, s3):
    code, err, kills, _ = kit.chaos(work, "s3://sky/chaos", 3, endpoint=s3)
    assert code == 0, err
    assert len(kills) >= 10 and set(kills) == set(kit.KINDS), kills
    assert kit.objects(s3, "sky/chaos") == reference


def test_two_drivers_at_once_make_the_same(work, reference, s3):
    for to, endpoint in (("set", ""), ("s3://sky/two", s3)):
        path = kit.cluster(work, to, workers=2, endpoint=endpoint)
        for driver in [kit.start(path), kit.start(path)]:
            out, err = driver.communicate(timeout=600)
            assert driver.returncode == 0, err
        assert (kit.objects(s3, "sky/two") if endpoint else kit.hashes(work / "set")) == reference
    assert no_scratch(work)


def test_a_driver_that_was_killed_is_gone_on_with(work, reference):
    path = kit.cluster(work, "set")
    driver = kit.start(path)
    while len(list((work / "set").glob("shards/*.json"))) < 5:
        assert driver.poll() is None, driver.communicate()[1]
        time.sleep(0.02)
    run = str(next((work / ".boresight-cluster").glob(f"cluster-{driver.pid}-*")))
    driver.kill()
    driver.communicate()
    code, told = kit.status(path)
    assert code == 3 and 0 < len(told["missing"]) < kit.SHARDS and not told["failed"] and not told["damaged"]
    assert all(str(driver.pid) in orphan for orphan in told["orphans"])
    assert told["orphans"], "the workers of a killed driver are not named"
    # They end by themselves, by the heartbeats that fail to come.
    begun = time.monotonic()
    while kit.processes(run):
        assert time.monotonic() - begun < 45, kit.processes(run)
        time.sleep(0.2)
    code, out, err = kit.ran(path)
    assert code == 0 and " are there, " in err and f"{kit.SHARDS} to do" not in err, err
    assert kit.hashes(work / "set") == reference
    code, told = kit.status(path, "--check")
    assert code == 0 and told["orphans"] == [] and not (work / ".boresight-cluster").exists()


def test_a_dead_interchange_is_replaced(work, reference):
    """All tasks go through it, and Parsl waits for it for ever."""
    path = kit.cluster(work, "set")
    driver = kit.start(path)
    while len(list((work / "set").glob("shards/*.json"))) < 3:
        assert driver.poll() is None, driver.communicate()[1]
        time.sleep(0.02)
    run = str(next((work / ".boresight-cluster").glob(f"cluster-{driver.pid}-*")))
    os.kill(kit.interchange(driver.pid), signal.SIGKILL)
    out, err = driver.communicate(timeout=300)
    told = "note: the interchange of Parsl, through which all tasks go, ended with -9; what is missing is given to new workers"
    assert driver.returncode == 0 and err.count(told) == 1 and err.count(f"{kit.SHARDS} to do") == 1, err
    assert not kit.processes(run) and not (work / ".boresight-cluster").exists(), "what the driver started is gone with it"
    assert kit.hashes(work / "set") == reference and no_scratch(work)


def test_tasks_that_are_lost_in_a_manager_that_lives_are_given_to_another(work, reference):
    """A worker that waits for a task holds the lock of the queue, and takes it along when it is killed: Parsl's manager lives and beats, and no task is
    taken any more."""
    last = kit.SHARDS - 1
    waits = f'[ -e "{work}/failed" ] || {{ while [ ! -e "{work}/go" ]; do sleep 0.1; done; touch "{work}/failed"; echo "error: later" >&2; exit 1; }}'
    path = kit.cluster(work, "set", more="patience_s = 20\n")
    driver = kit.start(path, binary=wrapped(work, "slow", f'case " $* " in *" --shard {last}/"*) {waits};; esac'))
    while len(list((work / "set").glob("shards/*.json"))) < last:
        assert driver.poll() is None, driver.communicate()[1]
        time.sleep(0.05)
    time.sleep(3)  # all others wait for a task
    for pid in kit.idle_workers(driver.pid, work):
        os.kill(pid, signal.SIGKILL)
    (work / "go").touch()
    out, err = driver.communicate(timeout=300)
    assert driver.returncode == 0 and "no sign of work for 20 s; what is missing is given to new workers" in err, err
    assert f"{last} of {kit.SHARDS} are there, 1 to do" in err, err
    assert kit.hashes(work / "set") == reference and no_scratch(work) and not (work / ".boresight-cluster").exists()


def test_an_interchange_that_stands_still_is_replaced_and_not_for_ever(work, reference):
    path = kit.cluster(work, "set", more="patience_s = 20\n")
    driver = kit.start(path)
    while len(list((work / "set").glob("shards/*.json"))) < 3:
        assert driver.poll() is None, driver.communicate()[1]
        time.sleep(0.02)
    os.kill(kit.interchange(driver.pid), signal.SIGSTOP)
    out, err = driver.communicate(timeout=300)
    assert driver.returncode == 0 and "no sign of work" in err, err
    assert kit.hashes(work / "set") == reference
    # One that stands still every time ends the run.
    shutil.rmtree(work / "set")
    driver = kit.start(kit.cluster(work, "set", tries=1, more="patience_s = 15\n"))
    stopped = []
    while driver.poll() is None:
        has_begun = list(work.glob(f".boresight-cluster/cluster-{driver.pid}-*/*/submit_scripts/*.sh"))
        found = kit.interchange(driver.pid, must=False)
        if has_begun and found and found not in stopped:
            os.kill(found, signal.SIGSTOP)
            stopped.append(found)
        time.sleep(0.01)
    err = driver.communicate()[1]
    assert driver.returncode == 1 and "error: no sign of work for 15 s, and no task ended 2 times in a row" in err, err
    assert len(stopped) == 2 and not (work / ".boresight-cluster").exists()


def test_a_folder_that_others_remove_is_made_anew(tmp_path):
    """A note is written while the last one beside it is removed, and its folder with it: that failed now and then, and a poisoned shard was tried twice."""
    from boresight_cluster.store import Folder

    failed = []

    def notes(name: str) -> None:
        store = Folder(tmp_path)
        try:
            for _ in range(300):
                store.write(f"notes/failed/{name}.json", b"why")
                store.remove(f"notes/failed/{name}.json")
        except OSError as error:
            failed.append(error)

    threads = [threading.Thread(target=notes, args=(str(own),)) for own in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed and not list(tmp_path.iterdir()), failed


def test_poison_is_tried_once_and_named(work, reference):
    """Of a dataset 2 and 3 are the end of it."""
    lines = [f'case " $* " in *" --shard {number}/"*) echo "error: no sky in {number}" >&2; exit {code};; esac' for number, code in ((3, 2), (5, 3))]
    path = kit.cluster(work, "set")
    code, _, err = kit.ran(path, binary=wrapped(work, "poison", "\n".join(lines)))
    assert code == 1
    assert "error: train-000003: boresight dataset ended with 2: error: no sky in 3\n" in err, err
    assert "error: train-000005: boresight dataset ended with 3: error: no sky in 5\n" in err, err
    assert [asked(work, number) for number in (3, 4, 5)] == [1, 1, 1]
    poisoned = {"train/000003", "train/000005", "train-000003", "train-000005"}
    there = {name: sum for name, sum in kit.of_shards(reference).items() if not any(part in name for part in poisoned)}
    assert kit.hashes(work / "set") == there
    code, told = kit.status(path)
    assert code == 3 and told["missing"] == ["train-000003", "train-000005"] and "no sky in 3" in told["failed"]["train-000003"]
    # With the cause gone the same command does the rest, and the notes go.
    assert kit.ran(path)[0] == 0
    assert kit.hashes(work / "set") == reference and not (work / "set/.boresight-cluster").exists()


def test_what_may_pass_is_tried_again_and_not_for_ever(work, reference):
    flaky = wrapped(
        work,
        "flaky",
        f'case " $* " in *" --shard 5/"*) [ -e "{work}/tried" ] || {{ touch "{work}/tried"; echo "error: no memory" >&2; exit 1; }};; esac',
    )
    assert kit.ran(kit.cluster(work, "set"), binary=flaky)[0] == 0
    assert asked(work, 5) == 2 and asked(work, 6) == 1
    assert kit.hashes(work / "set") == reference
    shutil.rmtree(work / "set")
    (work / "asked").unlink()
    broken = wrapped(work, "broken", 'case " $* " in *" --shard 5/"*) echo "error: no memory" >&2; exit 1;; esac')
    code, _, err = kit.ran(kit.cluster(work, "set", tries=3), binary=broken)
    assert code == 1 and "error: train-000005: boresight dataset ended with 1: error: no memory" in err, err
    assert asked(work, 5) == 3


def test_bytes_of_others_are_told_and_stay(work, reference, s3):
    import obstore

    for to, endpoint in (("set", ""), ("s3://sky/hand", s3)):
        path = kit.cluster(work, to, endpoint=endpoint)
        store = kit.bucket(s3, "sky/hand") if endpoint else None
        # Without a mark: the shard is made, held against what is there, and not put.
        name, mark = "train/000007.tar", "shards/train-000007.json"
        if store:
            obstore.put(store, name, b"mine")
        else:
            (work / "set/train").mkdir(parents=True)
            (work / "set" / name).write_bytes(b"mine")
            shutil.copy(work / "recipe.toml", work / "set/recipe.toml")
        code, _, err = kit.ran(path, "shard", "--shard", f"7/{kit.SHARDS}")
        assert code == 2 and f"{name}: is there with other bytes and is not overwritten" in err, err
        there = bytes(obstore.get(store, name).bytes()) if store else (work / "set" / name).read_bytes()
        assert there == b"mine"
        obstore.delete(store, name) if store else (work / "set" / name).unlink()
        assert kit.ran(path)[0] == 0
        # With a mark: `status` tells the size, and with --check the bytes.
        whole = bytes(obstore.get(store, name).bytes()) if store else (work / "set" / name).read_bytes()
        other = bytes([whole[0] ^ 1]) + whole[1:]
        obstore.put(store, name, other) if store else (work / "set" / name).write_bytes(other)
        assert kit.status(path)[0] == 0
        code, told = kit.status(path, "--check")
        assert code == 3 and len(told["damaged"]) == 1 and name in told["damaged"][0] and mark in told["damaged"][0]
        # A dataset of another recipe is refused.
        (work / "recipe.toml").write_text(kit.RECIPE.replace("seed = 5", "seed = 6"))
        code, _, err = kit.ran(path)
        assert code == 2 and "holds a dataset of another recipe" in err, err
        kit.recipe(work)


def test_a_command_over_a_list_has_the_answers_of_one_after_another(work):
    """Answers 0 and 3 are done, and 2 is never tried again."""
    items = [f"night {number}" for number in range(12)]
    for number, item in enumerate(items):
        faintest = 0.0 if number == 7 else 6.5  # a night of which the answer is no
        scene = f'format = "boresight-scene/1"\nseed = {number}\ncamera = {{ width_px = 256, height_px = 192, focal_length_px = 600.0 }}\n'
        scene += f'sky = {{ physics = "none", faintest_magnitude = {faintest} }}\n[[frames]]\nexposure_s = 1.0\n'
        scene += f"boresight_radec_deg = [{30 * number}.0, {5 * number - 30}.0]\n"
        (work / f"{item}.toml").write_text(scene)
        made = subprocess.run(
            [kit.program(), "simulate", f"{item}.toml", "-o", item, "--backend", "cpu", "--quiet"], cwd=work, capture_output=True, text=True
        )
        assert made.returncode == 0, made.stderr
    (work / "nights.txt").write_text("# nights\n" + "\n".join(items) + "\n")
    path = kit.cluster(work, "answers", work='command = "boresight identify {item} -o {out} --json"\nitems = "nights.txt"')
    code, out, err = kit.ran(path)
    assert code == 0 and "12 of 12 done" in out, err
    marks = [json.loads(mark.read_text()) for mark in (work / "answers/results").glob("*.json")]
    assert sorted(mark["item"] for mark in marks) == sorted(items)
    for mark in marks:
        alone = subprocess.run([kit.program(), "identify", mark["item"], "-o", "alone", "--json", "--force"], cwd=work, capture_output=True)
        assert alone.returncode == mark["exit_code"], alone.stderr
        packed = subprocess.run(["tar", "-xOf", str(work / "answers" / mark["file"]), "stdout"], capture_output=True, check=True).stdout
        assert timeless(packed) == timeless(alone.stdout)
    assert [mark["item"] for mark in marks if mark["exit_code"] == 3] == ["night 7"]
    # A list that grows makes what is new alone; a usage error is told and stops nothing.
    (work / "nights.txt").write_text("night 0\n--no-such-option\n" + "\n".join(items[1:]) + "\n")
    code, _, err = kit.ran(path)
    assert code == 1 and "12 of 13 are there, 1 to do" in err and "ended with 2" in err, err


def timeless(data: bytes) -> dict:
    """A result without its command line and the time that it took."""
    result = json.loads(data)
    assert result["format"].startswith("boresight-identify/") and result.pop("provenance")["command"]
    for frame in result["frames"]:
        frame.pop("seconds", None)
    return result


def test_a_printed_array_makes_what_is_missing(work, reference):
    slurm = '[engine.slurm]\npartition = "cpu"\nwalltime = "00:10:00"\nworker_init = "export WAS_HERE=yes"\nmax_tasks = 5\n'
    path = kit.cluster(work, "set", more=slurm)
    code, _, err = kit.ran(path, "shard", "--shard", "1/3")
    assert code == 0, err
    code, script, err = kit.ran(path, "slurm")
    assert code == 0, err
    assert "#SBATCH --array=0-4%4\n" in script and "#SBATCH --partition=cpu\n" in script and "--requeue" in script
    (work / "array.sh").write_text(script)
    for task in range(5):  # as slurmd calls it
        done = subprocess.run(["bash", "array.sh"], cwd=work, env=os.environ | {"SLURM_ARRAY_TASK_ID": str(task)}, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    assert kit.ran(path)[0] == 0
    assert kit.hashes(work / "set") == reference
    code, script, err = kit.ran(path, "slurm")
    assert (code, script) == (0, "") and "nothing is missing" in err


def test_images_stand_in_a_manifest_as_base64():
    from boresight_cluster.scripts import _texts_and_binaries

    texts, binaries = _texts_and_binaries({"sky.toml": "µ = 1".encode(), "glow.fits": b"\xff\x00\x10"})
    assert texts == {"sky.toml": "µ = 1"} and binaries == {"glow.fits": "/wAQ"}


def test_a_printed_manifest_is_what_kubernetes_takes(work, reference, s3):
    import kubernetes_validate

    pods = '[engine.kubernetes]\nimage = "registry/boresight:1.0"\nnamespace = "sim"\nsecret = "s3"\nmax_blocks = 3\n'
    path = kit.cluster(work, "s3://sky/pods", endpoint=s3, more=pods)
    assert kit.ran(path, "shard", "--shard", "0/2")[0] == 0
    code, manifest, err = kit.ran(path, "kubernetes")
    assert code == 0, err
    config, job = json.loads(manifest)["items"]
    version = kubernetes_validate.latest_version()
    for one in (config, job):
        kubernetes_validate.validate(one, version, strict=True)
    assert job["spec"]["completions"] == kit.SHARDS // 2 == len(config["data"]["missing"].split())
    broken = json.loads(json.dumps(job))
    broken["spec"]["completions"] = "all"
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(broken, version, strict=True)
    # What a pod does, with the folder of the ConfigMap elsewhere.
    folder = work / "config"
    folder.mkdir()
    for name, text in config["data"].items():
        (folder / name).write_text(text)
    shell, dash, script = job["spec"]["template"]["spec"]["containers"][0]["command"]
    script = script.replace("/config/", f"{folder}/").replace("python3", __import__("sys").executable)
    for index in range(3):
        pod = subprocess.run(
            [shell, dash, script], env=os.environ | kit.CREDENTIALS | {"JOB_COMPLETION_INDEX": str(index)}, capture_output=True, text=True
        )
        assert pod.returncode == 0, pod.stderr
    code, told = kit.status(path)
    assert code == 3 and len(told["missing"]) == kit.SHARDS // 2 - 3
    # A folder of this machine is nothing to a pod.
    code, _, err = kit.ran(kit.cluster(work, "set", more=pods), "kubernetes")
    assert code == 2 and "which pods do not see" in err


def test_what_is_wrong_with_the_file_is_told_with_its_remedy(work):
    for text, told in (
        ("", 'the first line must be format = "boresight-cluster/1"'),
        ('format = "boresight-cluster/1"\n[work]\nto = "set"\n', 'needs either dataset = "RECIPE.toml" or both command'),
        ('format = "boresight-cluster/1"\n[work]\ndataset = "recipe.toml"\n', 'needs to = "DIR"'),
        ('format = "boresight-cluster/1"\n[work]\ndataset = "no.toml"\nto = "set"\n', "no.toml is not there"),
        (
            'format = "boresight-cluster/1"\n[work]\ndataset = "recipe.toml"\nto = "set"\n[engine]\nworkers = 0\n',
            "engine.workers = 0 must be a whole number from 1 on",
        ),
        (
            'format = "boresight-cluster/1"\n[work]\ndataset = "recipe.toml"\nto = "set"\n[engine]\nworker = 1\n',
            "engine.worker is not known; [engine] has kind, workers",
        ),
        (
            'format = "boresight-cluster/1"\n[work]\ndataset = "recipe.toml"\nto = "set"\n[engine.slurm]\nnodes = 1\n',
            "engine.slurm.nodes is not known",
        ),
        (
            'format = "boresight-cluster/1"\n[work]\ndataset = "recipe.toml"\nto = "set"\n[engine]\nkind = "cloud"\n',
            "must be local, slurm or kubernetes",
        ),
    ):
        (work / "cluster.toml").write_text(text)
        code, _, err = kit.ran(work / "cluster.toml")
        assert code == 2 and told in err and err.count("\n") == 1, err
    code, _, err = kit.ran(kit.cluster(work, "set"), binary=str(work / "nothing"))
    assert code == 1 and "BORESIGHT_BINARY names" in err and "which is no program" in err
