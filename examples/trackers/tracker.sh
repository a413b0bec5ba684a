#!/bin/sh
# A star tracker behind a shell script as a system under test: image in, a table out. It calls `boresight identify`, in the place of a tracker of your own.
# tracker.sh IMAGE ANSWER [PROGRAM]
set -u
program=${3:-boresight}
text=$("$program" identify "$1" --json --quiet --centroid windowed)
code=$?
if [ $code -eq 3 ]; then
    printf 'status,qi,qj,qk,qw\nnone,,,,\n' > "$2"
    exit 0
fi
[ $code -eq 0 ] || exit $code
quaternion=$(printf '%s' "$text" | tr -d ' \n' | sed -n 's/.*"camera_from_icrs":\[\([^]]*\)\].*/\1/p')
printf 'status,qi,qj,qk,qw\nsolved,%s\n' "$quaternion" > "$2"
