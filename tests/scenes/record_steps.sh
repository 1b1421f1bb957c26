#!/bin/bash
# Records a run, kills it, replays it and compares the recordings: record_steps.sh BIN PYTHON
set -eu
bin=$1
python=$2
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
cd "$dir"
PATH=$bin:$PATH

step() { printf '\n%s\n' "## $*"; }
try() { printf '$ %s\n' "$*"; "$@"; }
# If the recorded loop was late, the replay repeats the fault and ends with status 1. `compare` checks the result.
hush() {
    printf '$ %s\n' "$*"
    "$@" >hushed.txt 2>&1 && return
    [ $? -eq 1 ] && grep 'the force was cut: the loop was late' hushed.txt || { cat hushed.txt; exit 1; }
}
# Runs a command that must exit with status 1, because recordings differ.
differ() { printf '$ %s\n' "$*"; if "$@"; then echo "the recordings do not differ"; exit 1; fi; }

step "a scene"
try palpate make two-bodies bodies.vdb
printf '$ palpate scene bodies.vdb > bodies.json\n'
palpate scene bodies.vdb 2>&1 >bodies.json | sed -n 's/^palpate: added: /added /p'

step "a run in real time is recorded, and killed after about 2 s"
printf '$ palpate feel bodies.json --realtime --seconds 60 --record monday.rec & sleep 2; kill -9 $!\n'
palpate feel bodies.json --realtime --seconds 60 --record monday.rec >feel.txt 2>&1 &
killed=$!
for ((i = 0; i < 400; ++i)); do [ -s monday.rec ] && break; sleep 0.05; done
sleep 2
kill -9 "$killed"
wait "$killed" 2>/dev/null || true
ls -l monday.rec | awk '{print $5, $9}'

step "numpy reads the recording with the lines of docs/recording.md"
try "$python" -c 'import json, numpy as np
head = json.loads(open("monday.rec", "rb").readline())
rows = np.fromfile("monday.rec", [tuple(f) for f in head["dtype"]], offset=head["offset"]); rows = rows[rows["tick"] > 0]
print(len(rows), "ticks,", rows["time"][-1].round(3), "s, at most", np.linalg.norm(rows["force"], axis=1).max().round(3), "N")
assert len(rows) > 1500'

step "a replay in the same scene: identical to the last bit"
hush palpate feel monday.rec --device replay:monday.rec --record again.rec
try palpate compare monday.rec again.rec

step "a replay in another scene: where and by how much the forces differ"
sed 's/"strength": 3,/"strength": 0.4,/; s/0.4\]\]/0.1]]/' bodies.json >other.json
hush palpate feel other.json --device replay:monday.rec --record other.rec
differ palpate compare monday.rec other.rec

step "the recording as a table, and as HDF5 if the build supports it"
try palpate convert monday.rec monday.csv
head -2 monday.csv | cut -c1-100
palpate convert monday.rec monday.h5 && ls -l monday.h5 | awk '{print $5, $9}' || echo "this build has no HDF5"
echo
echo "passed: recorded, killed, replayed and compared"
