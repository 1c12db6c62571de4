#!/bin/sh
# Make sure that a PostgreSQL server is installed for the tests that need one; the tests start and stop it themselves.
# As root it comes from Debian's package; otherwise this says what to install, and those tests are skipped.
set -eu

found() { command -v pg_ctl >/dev/null || ls /usr/lib/postgresql/*/bin/pg_ctl >/dev/null 2>&1; }

if found; then
    exit 0
fi
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq postgresql && exit 0
fi
echo "PostgreSQL is missing: its tests are skipped (Debian: apt-get install postgresql)" >&2
