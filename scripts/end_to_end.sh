#!/bin/sh
# The end-to-end and browser tests: sh scripts/end_to_end.sh .venv/bin/python -m pytest [ARGS]
# Flights that mostly wait (marked `beside`) are flown meanwhile; what they print comes last.
set -u

printed=$(mktemp)
trap 'rm -f "$printed"' EXIT
"$@" -m "e2e and beside" >"$printed" 2>&1 &
beside=$!
"$@" -m "(e2e or browser) and not beside"
others_status=$?
wait "$beside"
beside_status=$?
cat "$printed"
# 5 is pytest's word for "no test was chosen", which arguments may cause
for status in "$others_status" "$beside_status"; do
    [ "$status" = 0 ] || [ "$status" = 5 ] || exit "$status"
done
