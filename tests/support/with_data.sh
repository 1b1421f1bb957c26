#!/usr/bin/env bash
# Runs a command that needs the volumes of PALPATE_DATA. Without that variable exits with 77 (skipped).
if [ -z "${PALPATE_DATA:-}" ]; then
    echo "PALPATE_DATA is not set: see ./test.sh --data"
    exit 77
fi
exec "$@"
