#!/usr/bin/env python3
"""A dataset in other libraries: python tests/interop/loaders.py BORESIGHT FOLDER TORCH_PYTHON, called by `run` beside this file.

Every library reads every sample by the loader of python/loaders, and has to agree to the last bit with the frame rendered anew. The last line is
`N passed, N failed`. TORCH_PYTHON: a Python that has torch, which may be another one.
"""

import hashlib
import json
import os
import shutil
import subprocess
import sys
import traceback

import numpy as np
from PIL import Image

HERE = os.path.dirname(os.path.abspath(__file__))
LOADERS = os.path.join(os.path.dirname(os.path.dirname(HERE)), "python", "loaders")
sys.path.insert(0, LOADERS)
FRAMES = {"train": range(0, 20), "test": range(200_000_000, 200_000_005)}
SCENE = """format = "boresight-scene/1"
camera = { width_px = 96, height_px = 64, focal_length_px = 300.0 }
sky = { physics = "none" }
[[frames]]
exposure_s = 1.0
"""
# By the seed all frames of the first shard are without stars: types that a library guesses from the first samples are then wrong.
RECIPE = """format = "boresight-recipe/1"
name = "loaded"
seed = 39
scene = "sky.toml"
licence = "CC-BY-4.0"
[size]
frames = { train = 20, test = 5 }
frames_per_shard = 5
image = "png16"
members = ["mask", "distance"]
[cameras]
train = 2
test = 1
[splits]
apart_by = ["camera"]
[[draw]]
per = "frame"
path = "frames.rate_deg_s"
ball = { radius = 0.5 }
[hard]
no_stars = 0.6
"""
counts = {"passed": 0, "failed": 0}


def check(function, *arguments):
    """One line for every check; one that raises has failed."""
    try:
        print(f"ok      {function.__name__}: {function(*arguments)}", flush=True)
        counts["passed"] += 1
    except Exception as error:  # whatever goes wrong is a failure of this check alone
        counts["failed"] += 1
        print(f"FAILED  {function.__name__}: {error}", flush=True)
        traceback.print_exc()


def ran(*words, **more):
    """A program that has to succeed; what it printed."""
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, **more)
    assert done.returncode == 0, f"{' '.join(map(str, words))}: {done.stderr[-2000:]}"
    return done.stdout


class Made:
    """The datasets, and every frame of them rendered anew."""

    def __init__(self, program, folder):
        self.program, self.folder = program, folder
        self.recipes = {}
        for kind, recipe in (
            ("png", RECIPE),
            ("npy", RECIPE.replace("png16", "npy").replace('"distance"]', '"distance", "clean"]')),
            ("rice", RECIPE.replace("png16", "fits-rice")),
        ):
            os.makedirs(os.path.join(folder, kind))
            self.recipes[kind] = os.path.join(folder, kind, "recipe.toml")
            for name, text in (("sky.toml", SCENE), ("recipe.toml", recipe)):
                with open(os.path.join(folder, kind, name), "w", encoding="utf-8") as out:
                    out.write(text)
            ran(program, "dataset", self.recipes[kind], "-o", self.at(kind), "--quiet")
        self.alone = {}
        for key in [key for keys in FRAMES.values() for key in keys]:
            ran(program, "dataset", self.recipes["png"], "--frame", key, "-o", os.path.join(folder, "alone"), "--quiet")
            start = os.path.join(folder, "alone", f"{key:09}.")
            with open(start + "json", encoding="utf-8") as file:
                labels = json.load(file)
            images = {member: np.asarray(Image.open(f"{start}{member}.png")) for member in ("image", "mask", "distance")}
            self.alone[key] = {"json": labels, "clean": np.load(start + "clean.npy")} | images
        first = json.load(open(os.path.join(self.at("png"), "shards", "train-000000.json"), encoding="utf-8"))
        assert first["starless_frames"] == first["frames"] == 5, "the first shard is to be without stars: look for another seed"
        assert max(frame["image"].max() for frame in self.alone.values()) > 255, "no frame needs more than 8 bits"

    def at(self, kind):
        """The folder of a dataset."""
        return os.path.join(self.folder, kind, "set")

    def same(self, key, image, labels=None, **images):
        """That a sample agrees with the frame rendered anew; its counts by their hash too, which no decoder of ours has a part in."""
        alone = self.alone[key]
        assert image.dtype == np.uint16, f"frame {key}: counts are {image.dtype}"
        assert hashlib.sha256(image.astype("<u2").tobytes()).hexdigest() == alone["json"]["pixels_sha256"], f"frame {key}: other counts"
        for name, found in {"image": image, **images}.items():
            assert found.shape == alone[name].shape and np.array_equal(found, alone[name]), f"frame {key}: another {name}"
        assert labels is None or labels == alone["json"], f"frame {key}: other labels"

    def all(self, keys, split):
        """That every sample was there once."""
        assert sorted(keys) == list(FRAMES[split]), f"{split}: {len(keys)} samples, {len(set(keys))} different"


def numpy_reads_every_sample(made):
    """numpy and Pillow, of PNG and of arrays; astropy, of FITS packed by Rice coding."""
    from load_numpy import samples

    for kind in made.recipes:
        for split in FRAMES:
            keys = []
            for sample in samples(made.at(kind), split):
                keys.append(int(sample["key"]))
                more = {"clean": sample["clean"]} if kind == "npy" else {}
                made.same(keys[-1], sample["image"], sample["json"], mask=sample["mask"], distance=sample["distance"], **more)
            made.all(keys, split)
    return f"{len(made.recipes) * len(made.alone)} samples"


def astropy_reads_the_same_of_simulate(made):
    """The scene of every frame by `simulate`, as FITS: another way through the program and another reader."""
    from astropy.io import fits

    for key, frame in made.alone.items():
        scene, into = os.path.join(made.folder, f"{key}.toml"), os.path.join(made.folder, f"simulated {key}")
        with open(scene, "w", encoding="utf-8") as out:
            out.write(ran(made.program, "dataset", made.recipes["png"], "--scene", key))
        ran(made.program, "simulate", scene, "-o", into, "--backend", "cpu", "--quiet")
        [image] = [os.path.join(at, name) for at, _, names in os.walk(into) for name in names if name.endswith((".fits", ".fits.fz"))]
        with fits.open(image) as file:
            data = next(part.data for part in file if part.data is not None)
        assert np.array_equal(data, frame["image"]), f"frame {key}: simulate makes another"
        shutil.rmtree(into)
    return f"{len(made.alone)} frames"


def webdataset_reads_every_sample(made):
    """webdataset with our decoder, of PNG, arrays and FITS, in order and shuffled by shards."""
    from load_webdataset import pipeline

    for kind, end in (("png", "png"), ("npy", "npy"), ("rice", "fits")):
        for split, more in ((split, more) for split in FRAMES for more in ({}, {"shardshuffle": 100})):
            keys = []
            for sample in pipeline(made.at(kind), split, **more):
                keys.append(int(sample["__key__"]))
                clean = {"clean": sample["clean.npy"]} if kind == "npy" else {}
                made.same(keys[-1], sample[f"image.{end}"], sample["json"], mask=sample["mask.png"], distance=sample["distance.png"], **clean)
            made.all(keys, split)
    return f"{6 * len(made.alone)} samples"


def eight_bits_are_caught(made):
    """webdataset's own decoder cuts counts to 8 bits: the comparison sees it."""
    import webdataset

    shards = [os.path.join(made.at("png"), "train", f"{shard:06}.tar") for shard in range(4)]
    caught = 0
    for sample in webdataset.WebDataset(shards, shardshuffle=False).decode("l8"):
        try:
            made.same(int(sample["__key__"]), np.asarray(sample["image.png"]).astype(np.uint16))
        except AssertionError:
            caught += 1
    assert caught > 0, "8 bits pass for 16"
    return f"{caught} of 20 samples differ"


def datasets_reads_every_sample(made):
    """Hugging Face's datasets, with and without streaming, the first shard without a star."""
    from load_huggingface import load

    read = 0
    for split in FRAMES:
        for more in ({"streaming": True}, {"cache_dir": os.path.join(made.folder, "cache")}):
            keys = []
            for sample in load(made.at("png"), split, **more):
                keys.append(int(sample["__key__"]))
                images = {name: np.asarray(sample[f"{name}.png"]) for name in ("image", "mask", "distance")}
                assert sample["image.png"].mode == "I;16", sample["image.png"].mode
                made.same(keys[-1], images.pop("image"), sample["json"], **images)
            made.all(keys, split)
            read += len(keys)
    return f"{read} samples"


def polars_reads_every_light(made):
    """All lights as a table."""
    from load_polars import lights

    rows = 0
    for split in FRAMES:
        table = lights(made.at("png"), split)
        rows += len(table)
        for key in FRAMES[split]:
            own = table.filter(table["key"] == key).drop("key").to_dict(as_series=False)
            assert own == made.alone[key]["json"]["lights"], f"frame {key}: other lights"
    assert rows > 20, f"{rows} lights tell nothing"
    return f"{rows} lights"


def torch_reads_every_sample(made, python):
    """torch's DataLoader with no, 2 and 4 workers, and with more workers than there are shards; in a Python of its own."""
    into, workers, said = os.path.join(made.folder, "torch.npz"), (0, 2, 4, 7), []
    for kind in made.recipes:
        for split in FRAMES:
            said = ran(python, os.path.join(HERE, "torch_loader.py"), LOADERS, made.at(kind), split, into, *workers).split()
            with np.load(into) as read:
                for count in workers:
                    made.all(read[f"key {count}"].tolist(), split)
                    for key, image, distance in zip(*(read[f"{name} {count}"] for name in ("key", "image", "distance")), strict=True):
                        assert image.dtype == np.float32 and np.array_equal(image, made.alone[key]["image"]), f"frame {key}: other counts"
                        made.same(int(key), image.astype(np.uint16), distance=distance)
    return f"torch {' '.join(said)}, {', '.join(map(str, workers))} workers"


def tables_are_those_of_labels(made):
    """Tables of frames and of lights by polars and by astropy."""
    import polars
    from astropy.table import Table

    rows = 0
    for split in FRAMES:
        keys = []
        for name in sorted(os.listdir(os.path.join(made.at("png"), "tables", split))):
            path = os.path.join(made.at("png"), "tables", split, name)
            table = polars.read_parquet(path)
            rows += len(table)
            # astropy reads no column of words in a table without rows: it asks for the longest of none.
            assert not len(table) or len(Table.read(path)) == len(table), f"{name}: astropy reads another number of rows"
            if name.endswith(".frames.parquet"):
                for row in table.to_dicts():
                    labels = made.alone[row["key"]]["json"]
                    keys.append(row["key"])
                    same = [name for name in row if name in labels and isinstance(labels[name], (int, float, str))]
                    assert len(same) > 15 and all(row[name] == labels[name] for name in same), f"frame {row['key']}: another row"
                continue
            for key in table["key"].unique().to_list():
                own = table.filter(table["key"] == key).to_dict(as_series=False)
                lights = made.alone[key]["json"]["lights"]
                assert {name: own[name] for name in lights} == lights, f"frame {key}: other lights"
        made.all(keys, split)
    return f"{rows} rows"


def mlcroissant_reads_every_record(made):
    """croissant.json: labels and images of every frame."""
    import mlcroissant

    dataset = mlcroissant.Dataset(jsonld=os.path.join(made.at("png"), "croissant.json"))
    all_keys = sorted(made.alone)
    plain = {name: value for name, value in next(iter(made.alone.values()))["json"].items() if isinstance(value, (int, float, str))}
    keys = []
    for record in dataset.records("frames"):
        record = {name.rpartition("/")[2]: value.decode() if isinstance(value, bytes) else value for name, value in record.items()}
        keys.append(int(record["key"]))
        labels = made.alone[keys[-1]]["json"]
        assert all(record[name] == labels[name] for name in record if name in plain), f"frame {keys[-1]}: another record"
    assert sorted(keys) == all_keys, f"{len(keys)} records of frames"
    keys = []
    for record in dataset.records("image-files"):
        record = {name.rpartition("/")[2]: value for name, value in record.items()}
        name = record["filename"].decode() if isinstance(record["filename"], bytes) else record["filename"]
        keys.append(int(os.path.basename(name).partition(".")[0]))
        made.same(keys[-1], np.asarray(record["content"]))
    assert sorted(keys) == all_keys, f"{len(keys)} records of images"
    return f"{2 * len(keys)} records"


def pycocotools_reads_every_annotation(made):
    """An export as COCO: boxes and centres from the corner of the first pixel."""
    from pycocotools.coco import COCO

    into, keys, lights = os.path.join(made.folder, "coco"), [], 0
    ran(made.program, "dataset", "export", made.at("png"), "--to", "coco", "-o", into, "--quiet")
    for name in sorted(os.listdir(os.path.join(into, "annotations"))):
        if name == "categories.json":
            continue
        coco = COCO(os.path.join(into, "annotations", name))
        for key, image in coco.imgs.items():
            keys.append(key)
            made.same(key, np.asarray(Image.open(os.path.join(into, "images", image["file_name"]))))
            own, found = made.alone[key]["json"]["lights"], coco.loadAnns(coco.getAnnIds(imgIds=[key]))
            expected = [(x + 0.5, y + 0.5) for x, y, is_visible in zip(own["x_px"], own["y_px"], own["visible"], strict=True) if is_visible]
            assert [tuple(one["keypoints"][:2]) for one in found] == expected, f"frame {key}: other places"
            lights += len(found)
    assert sorted(keys) == sorted(made.alone), f"{len(keys)} images"
    return f"{len(keys)} images, {lights} annotations"


def datasets_reads_the_export(made):
    """An export as Parquet: datasets takes the image and its types from the file itself."""
    import datasets

    into = os.path.join(made.folder, "parquet")
    ran(made.program, "dataset", "export", made.at("png"), "--to", "parquet", "-o", into, "--quiet")
    for split in FRAMES:
        files = [os.path.join(into, "data", name) for name in sorted(os.listdir(os.path.join(into, "data"))) if name.startswith(split)]
        keys = []
        for sample in datasets.load_dataset("parquet", data_files=files, split="train", cache_dir=os.path.join(made.folder, "cache")):
            keys.append(sample["key"])
            made.same(sample["key"], np.asarray(sample["image"]))
        made.all(keys, split)
    return f"{len(made.alone)} samples"


def datasets_goes_by_the_card(made):
    """The folder alone: datasets takes splits and types from the head of README.md."""
    import datasets

    read = datasets.load_dataset(made.at("png"), cache_dir=os.path.join(made.folder, "cache"))
    for split in FRAMES:
        keys = []
        for sample in read[split]:
            keys.append(int(sample["__key__"]))
            made.same(keys[-1], np.asarray(sample["image.png"]), sample["json"])
        made.all(keys, split)
    return f"{len(made.alone)} samples"


# Every loader, and every other program that reads what a dataset is written as.
CHECKS = [
    numpy_reads_every_sample,
    astropy_reads_the_same_of_simulate,
    webdataset_reads_every_sample,
    eight_bits_are_caught,
    datasets_reads_every_sample,
    polars_reads_every_light,
    tables_are_those_of_labels,
    mlcroissant_reads_every_record,
    pycocotools_reads_every_annotation,
    datasets_reads_the_export,
    datasets_goes_by_the_card,
]


def main(program, folder, torch_python):
    """Makes the datasets and lets everything read them."""
    # mlcroissant keeps what it has unpacked by the archive's relative path, whatever dataset that was of.
    caches = {"HF_HOME": "huggingface", "CROISSANT_CACHE": "croissant"}
    os.environ.update({name: os.path.join(folder, own) for name, own in caches.items()}, HF_HUB_OFFLINE="1")
    shutil.rmtree(folder, ignore_errors=True)
    os.makedirs(folder)
    made = Made(program, folder)
    for function in CHECKS:
        check(function, made)
    check(torch_reads_every_sample, made, torch_python)
    print(f"{counts['passed']} passed, {counts['failed']} failed")
    return 1 if counts["failed"] or not counts["passed"] else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
