#!/usr/bin/env bash
# Virtual boards at 10 records a second of 4 sensors each, logged durably on this machine: what is stored, what it costs.
#
#   link-load.sh [BOARDS [SECONDS]]                THERMOKIN=path/to/thermokin, 10000 boards and 30 seconds by default
set -euo pipefail
boards=${1:-10000} seconds=${2:-30}
thermokin=$(realpath "${THERMOKIN:-target/release/thermokin}")
folder=$(mktemp -d "${STORE_IN:-/tmp}/link-load.XXXX")
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"$thermokin" board virtual --registry boards.toml --count "$boards" --duration 0 --drain 0 >/dev/null
"$thermokin" log --plain --registry boards.toml --store store --listen 127.0.0.1:5841 --json log.json >log.txt 2>&1 &
pid=$!
sleep 1
"$thermokin" board virtual --registry boards.toml --count "$boards" --rate 10 --batch 10 --host 127.0.0.1:5841 \
    --duration "$seconds" --drain 120
grep -E 'VmHWM|VmRSS' "/proc/$pid/status"
awk -v ticks="$(getconf CLK_TCK)" '{ printf "logger: %.2f CPU seconds\n", ($14 + $15) / ticks }' "/proc/$pid/stat"
kill -INT "$pid"
wait "$pid"
tail -n 1 log.txt
cat log.json
du -sh store
