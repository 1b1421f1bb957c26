#!/usr/bin/env bash
# Runs a command that needs the volumes of PALPATE_DATA. Exits with 77 (skipped) if it is not set.
if [ -z "${PALPATE_DATA:-}" ]; then
    echo "PALPATE_DATA is not set: see ./test.sh --data"
    exit 77
fi
exec "$@"
