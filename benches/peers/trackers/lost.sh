#!/bin/sh
# LOST as a system under test: lost.sh IMAGE ANSWER WIDTH_DEG. LOST_BIN names the program, LOST_DATABASE a database that it made for this width.
exec "$LOST_BIN" pipeline --png "$1" --fov "$3" --centroid-algo cog --centroid-filter-brightest 20 --database "${LOST_DATABASE:?make one with $LOST_BIN database}" \
    --star-id-algo py --angular-tolerance 0.04 --false-stars 1000 --max-mismatch-prob 0.0001 --attitude-algo dqm --print-attitude "$2"
