# SPDX-License-Identifier: GPL-3.0-or-later
# Each target of a Makefile with the comment above it: awk -f tools/help.awk Makefile
/^# / { text = text (text ? sprintf("\n%12s", "") : "") substr($0, 3); next }
/^[a-z-]+:/ && text { printf "%-11s %s\n", substr($0, 1, index($0, ":") - 1), text }
!/^[a-z_]+ \?=/ { text = "" }
