#!/usr/bin/env bash
# Writes palpate.1 and a page for each verb: man_pages.sh PALPATE FOLDER HELP2MAN
set -euo pipefail
mkdir -p "$2"
version=$("$1" --version | head -1)
page() {
    local name=palpate${5:+-$5}
    "$3" --no-info --no-discard-stderr --version-string "$name ${version#palpate }" --name "$4" \
        --output "$2/$name.1" "$1${5:+ $5}"
}
page "$1" "$2" "$3" "feel a volume" ""
"$1" --help | sed -n '/^Subcommands:/,/^$/p' | sed '1d;/^$/d' | while read -r verb what; do
    page "$1" "$2" "$3" "$what" "$verb"
done
