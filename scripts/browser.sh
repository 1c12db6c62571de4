#!/bin/sh
# See to it that the browser tests find a Chromium and its driver; without them those tests are skipped, no others.
set -eu
if command -v chromium >/dev/null && command -v chromedriver >/dev/null; then exit 0; fi
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq chromium chromium-driver >/dev/null && exit 0
fi
echo "the dashboard's browser tests will be skipped: they need chromium and chromedriver" \
    "(Debian: apt-get install chromium chromium-driver)" >&2
