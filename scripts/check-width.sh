#!/usr/bin/env bash
# Fails if a comment in Rust, WGSL or a shell script, or a line of Markdown, is wider than 120 columns, and lists each
# such line.
# Not counted: tables, code blocks of Markdown, and the addresses of web pages, which cannot be broken. Code is
# rustfmt's business.
set -euo pipefail
cd "$(dirname "$0")/.."

# awk may count bytes or characters, so it is told to count bytes, without those that continue a UTF-8 character.
find_wide_lines() {
    git ls-files -z -- '*.rs' '*.wgsl' '*.md' '*.sh' .ci/run | LC_ALL=C xargs -0 awk '
        FNR == 1 { in_code_block = 0; is_markdown = FILENAME ~ /[.]md$/; is_shell = FILENAME ~ /[.]sh$|^[.]ci\/run$/ }
        is_markdown && /^ *```/ { in_code_block = !in_code_block }
        is_markdown && (in_code_block || /^ *[|]/) { next }
        is_shell && !/^[ \t]*#/ { next }
        !is_markdown && !is_shell && (!/(^|[ \t])\/\// || /^ *\/\/[\/!]? *[|]/) { next }
        {
            text = $0
            gsub(/https?:\/\/[^ )>]*/, "", text)
            gsub(/[\200-\277]/, "", text)
            if (length(text) > 120) print FILENAME ":" FNR ": " length(text) " columns"
        }'
}

wide_lines=$(find_wide_lines)
if [ -n "$wide_lines" ]; then
    echo "$wide_lines"
    echo "$(wc -l <<<"$wide_lines") lines are wider than 120 columns" >&2
    exit 1
fi
