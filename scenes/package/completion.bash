# palpate's verbs, and each verb's options, as they say themselves.
_palpate() {
    local word=${COMP_WORDS[COMP_CWORD]} verb=
    [ "$COMP_CWORD" -gt 1 ] && verb=${COMP_WORDS[1]}
    if [ -z "$verb" ]; then
        local verbs
        verbs=$(palpate --help 2>/dev/null | sed -n '/^Subcommands:/,/^$/s/^  \([a-z]*\) .*/\1/p')
        mapfile -t COMPREPLY < <(compgen -W "$verbs --help --version" -- "$word")
    elif [[ $word == -* ]]; then
        mapfile -t COMPREPLY < <(compgen -W "$(palpate "$verb" --help 2>/dev/null |
            grep -oE '^  (-h,)?--[a-z0-9-]+' | sed 's/.*--/--/')" -- "$word")
    else
        mapfile -t COMPREPLY < <(compgen -f -- "$word")
    fi
}
complete -o filenames -F _palpate palpate
