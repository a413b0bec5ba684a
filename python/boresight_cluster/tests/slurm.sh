#!/usr/bin/env bash
# A real Slurm on this machine: slurm.sh BORESIGHT FOLDER PYTHON. Installs Debian's slurm-wlm and munge, runs controller and node daemon with a
# configuration of its own, and makes the small dataset of the tests three ways: by the program, by the array script that `boresight-cluster slurm` prints
# (one task of it cancelled, the missing ones submitted anew), and by `boresight-cluster run` with Parsl's SlurmProvider. All must have the same hashes.
# Needs root. The last line is `N passed, N failed`.
set -uo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../../.." && pwd)
program=$(realpath "${1:?name the boresight to be tried}")
work=$(realpath -m "${2:?name a folder}")
python=${3:?name a Python with boresight-cluster}
failed() { echo "slurm: $1" >&2; echo "0 passed, 1 failed"; exit 1; }
[ "$(id -u)" -eq 0 ] || failed "needs root, for Slurm's daemons"
command -v slurmctld >/dev/null && command -v slurmd >/dev/null && command -v munged >/dev/null || "$root/.ci/apt" slurm-wlm munge || failed "Slurm does not install (Debian: slurm-wlm)"
rm -rf "$work"; mkdir -p "$work"/{spool,state,munge,log}
host=$(hostname -s)
export SLURM_CONF="$work/slurm.conf" PATH="$PATH:/usr/sbin"

pids=()
stop() {
    timeout -k 1 10 scancel --user=root 2>/dev/null
    # The last one begun goes first: the others sign and answer for it.
    for ((at = ${#pids[@]} - 1; at >= 0; at--)); do
        kill "${pids[at]}" 2>/dev/null
        for _ in $(seq 50); do kill -0 "${pids[at]}" 2>/dev/null || break; sleep 0.1; done
        kill -9 "${pids[at]}" 2>/dev/null
    done
}
trap stop EXIT

# Munge signs what the daemons say to each other: a socket and a key of our own, so that one of the system's is left alone.
dd if=/dev/urandom of="$work/munge/key" bs=1024 count=1 2>/dev/null
chmod 400 "$work/munge/key"; chmod 711 "$work" "$work/munge"
munged --foreground --force --key-file "$work/munge/key" --socket "$work/munge/socket" --pid-file "$work/munge/pid" --log-file "$work/log/munge" --seed-file "$work/munge/seed" >"$work/log/munged.out" 2>&1 & pids+=($!)

free_port() { "$python" -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])'; }
cat >"$SLURM_CONF" <<CONF
ClusterName=boresight
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=$(free_port)
SlurmdPort=$(free_port)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$work/munge/socket
CredType=cred/munge
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
SlurmctldLogFile=$work/log/slurmctld
SlurmdLogFile=$work/log/slurmd
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=sched_interval=1,batch_sched_delay=0
MpiDefault=none
ReturnToService=2
KillWait=2
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc) State=UNKNOWN
PartitionName=cpu Nodes=$host Default=YES MaxTime=INFINITE State=UP
CONF
for _ in $(seq 50); do [ -S "$work/munge/socket" ] && break; sleep 0.1; done
[ -S "$work/munge/socket" ] || failed "munged does not run: $(tail -n 3 "$work/log/munge")"
slurmctld -D -i >"$work/log/ctld.out" 2>&1 & pids+=($!)
slurmd -D >"$work/log/slurmd.out" 2>&1 & pids+=($!)
for _ in $(seq 100); do sinfo --noheader --format=%T 2>/dev/null | grep -qx idle && break; sleep 0.2; done
sinfo --noheader --format=%T 2>/dev/null | grep -qx idle || failed "the node does not come up: $(sinfo 2>&1; tail -n 5 "$work/log/slurmd" "$work/log/slurmctld")"

passed=0 failures=0
check() { if "${@:2}"; then passed=$((passed + 1)); echo "ok: $1"; else failures=$((failures + 1)); echo "FAILED: $1"; fi; }
sums() { (cd "$1" && find . -name .boresight-cluster -prune -o -type f -print0 | sort -z | xargs -0 sha256sum); }
same() { diff <(sums "$work/one/set") <(sums "$1") >"$work/log/diff" || { head -n 5 "$work/log/diff" >&2; return 1; }; }
ended() { for _ in $(seq 600); do [ -z "$(squeue --noheader --user root)" ] && return 0; sleep 0.2; done; squeue >&2; return 1; }
folder() { # NAME ENGINE-LINES: a folder with the recipe and CLUSTER.toml
    mkdir -p "$work/$1/scratch"
    (cd "$here" && "$python" -c 'import pathlib, sys, kit; kit.recipe(pathlib.Path(sys.argv[1]))' "$work/$1")
    printf 'format = "boresight-cluster/1"\n[work]\ndataset = "recipe.toml"\nto = "set"\n[engine]\nscratch = "scratch"\n%s' "$2" >"$work/$1/slurm.toml"
}
cluster() { BORESIGHT_BINARY="$program" "$python" -m boresight_cluster "$@"; }
export BORESIGHT_BINARY="$program"

folder one ''
(cd "$work/one" && "$program" dataset recipe.toml -o set --quiet >/dev/null) || failed "the program makes no dataset"

folder array $'kind = "slurm"\nworkers = 2\n[engine.slurm]\npartition = "cpu"\nmax_tasks = 12\n'
cd "$work/array" || exit 1
cluster slurm slurm.toml >array.sh
check "an array script is printed" grep -q '^#SBATCH --array=0-11%' array.sh
job=$(sbatch --parsable array.sh) && scancel "${job}_11"
check "an array of 12 tasks ends" ended
cluster status slurm.toml >"$work/log/status" 2>&1
check "what was cancelled is missing" test $? -eq 3
cluster slurm slurm.toml >again.sh && sbatch --parsable again.sh >/dev/null
check "an array of what is missing ends" ended
check "run finishes what is there" cluster run slurm.toml
check "the array made the same bytes" same "$work/array/set"

folder blocks $'kind = "slurm"\nworkers = 2\n[engine.slurm]\npartition = "cpu"\nwalltime = "00:05:00"\n'
cd "$work/blocks" || exit 1
begun=$SECONDS
check "Parsl makes the shards in a block of Slurm" timeout 120 "$python" -m boresight_cluster run slurm.toml
echo "blocks of Slurm: $((SECONDS - begun)) s; all of it: $SECONDS s"
check "the block made the same bytes" same "$work/blocks/set"
echo "$passed passed, $failures failed"
[ "$failures" -eq 0 ]
