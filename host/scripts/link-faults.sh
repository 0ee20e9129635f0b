#!/usr/bin/env bash
# The link under fire, with the real binary: 30% loss, reordering, duplicates, delays, flipped bits, replays, two forgers,
# rebooting boards, and the logger killed with SIGKILL at unequal times. At the end the store must equal the truth, record
# for record.
#
#   link-faults.sh [SECONDS [KILLS [SEED]]]        THERMOKIN=path/to/thermokin, 600 seconds and 20 kills by default
set -euo pipefail
seconds=${1:-600} kills=${2:-20} seed=${3:-1}
thermokin=${THERMOKIN:-target/release/thermokin}
thermokin=$(realpath "$thermokin")
folder=$(mktemp -d)
cd "$folder"
echo "in $folder, seed $seed"
"$thermokin" board virtual --registry boards.toml --count 8 --duration 0 --drain 0 >/dev/null
logger() {
    "$thermokin" log --plain --registry boards.toml --store store --rotate-mib 4 --listen 127.0.0.1:5840 2>>log.txt >/dev/null &
    pid=$!
}
logger
"$thermokin" board virtual --registry boards.toml --count 8 --seed "$seed" --rate 10 --batch 5 --host 127.0.0.1:5840 \
    --duration "$seconds" --drain 120 --truth truth.csv --loss 0.3 --reorder 0.1 --duplicate 0.1 --delay 50 \
    --corrupt 0.01 --replay 0.05 --reboot 60 --retain 1 --bad-keys 2 &
boards=$!
RANDOM=$seed
for _ in $(seq "$kills"); do
    # Between 0.4 and 1.3 times the mean time, in milliseconds.
    pause=$((seconds * 1000 / (kills + 1) * (40 + RANDOM % 90) / 100))
    sleep "$((pause / 1000)).$(printf %03d $((pause % 1000)))"
    kill -9 "$pid"
    wait "$pid" 2>/dev/null || true
    logger
done
wait "$boards"
kill -9 "$pid"
wait "$pid" 2>/dev/null || true
# One more start finishes the file that the last kill left; a signal ends it in good order.
logger
sleep 2
kill -INT "$pid"
wait "$pid"
"$thermokin" log doctor store --truth truth.csv
