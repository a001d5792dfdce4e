#!/bin/sh
# `invid simcell` and `invid measure` over SocketCAN on the kernel's virtual CAN, then identify. Says so and ends well
# where the kernel has no vcan. Needs root (or sudo) to make the link.
#
#     sh scripts/vcan-job.sh [FOLDER]
set -eu
cd "$(dirname "$0")/.."
out="${1:-vcan-job}"
invid="${INVID:-.venv/bin/invid}"
config=configs/vcan-case-study.yaml
root=""
[ "$(id -u)" = 0 ] || root=sudo

if [ ! -e /sys/class/net/vcan0 ]; then
  $root modprobe vcan 2>/dev/null || true
  if ! $root ip link add vcan0 type vcan 2>/dev/null; then
    echo "::warning::this kernel has no vcan ($(uname -r)): measuring over socketcan was NOT tried"
    exit 0
  fi
fi
$root ip link set vcan0 up
mkdir -p "$out"
"$invid" simcell "$config" --json > "$out/simcell.json" 2> "$out/simcell.log" &
cell=$!
trap 'kill "$cell" 2>/dev/null || true' EXIT
sleep 5
kill -0 "$cell" || { cat "$out/simcell.log"; exit 1; }
"$invid" measure "$config" --axes A1 --yes -o "$out/rec.h5"
"$invid" identify "$out/rec.h5" -o "$out/model.json" || [ $? = 3 ]
echo "measured over socketcan on vcan0: $out/rec.h5"
