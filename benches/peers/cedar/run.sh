#!/usr/bin/env bash
# cedar-detect beside boresight on the same frames: run.sh CHECKOUT PAGE, a checkout of https://github.com/smroid/cedar-detect (Functional Source
# License; nothing of it is kept here) and the file that the table goes to. Its three files are compiled as they are into a program of their own under target/peers.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../../.." && pwd)
checkout=${1:?name a checkout of cedar-detect: git clone https://github.com/smroid/cedar-detect, then make bench-cedar CEDAR=cedar-detect}
page=${2:?name the file that the table goes to}
[ -f "$checkout/src/algorithm.rs" ] || { echo "run.sh: $checkout/src/algorithm.rs is missing: name a checkout of cedar-detect" >&2; exit 2; }
work="$root/target/peers/cedar"
mkdir -p "$work/src"
page=$(realpath "$page")
ln -sfn "$(cd "$checkout/src" && pwd)" "$work/src/cedar"
cp "$here/main.rs" "$work/src/main.rs"
cp "$root/Cargo.lock" "$work/Cargo.lock"
cat >"$work/Cargo.toml" <<TOML
[package]
name = "beside-cedar"
version = "0.0.0"
edition = "2021"

[dependencies]
boresight = { path = "$root" }
image = { version = "0.25", default-features = false }
imageproc = { version = "0.27", default-features = false }
log = "0.4"
rand = "0.10"
rand_distr = "0.6"
rand_pcg = "0.10"
rayon = "1"
rustix = { version = "1", features = ["time"] }

[workspace]
TOML
cd "$work"
CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$root/target}" cargo build --release
"${CARGO_TARGET_DIR:-$root/target}/release/beside-cedar" | tee "$page.part"
mv "$page.part" "$page"
