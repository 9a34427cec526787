_mjmerge_scenarios=@scenarios@
_mjmerge_table='@table@'

# What the key $1 may be, or if that is empty all keys that begin with $2, up to the next dot; of the sections $3.
_mjmerge_keys() {
  local word file= found=
  for word in "${COMP_WORDS[@]}"; do
    for file in "$word" "$word/scenario.yaml" "$_mjmerge_scenarios/$word.yaml"; do
      case $file in *.yaml) [ -f "$file" ] && found=$file && break 2 ;; esac
    done
  done
  case $found in '' | /*) ;; *) found=./$found ;; esac
  printf '%s\n' "$_mjmerge_table" |
    line="${COMP_WORDS[*]}" key=$1 cur=$2 only=$3 awk '
      function note(line, asked,  word) {  # who is there, and of which kind
        while (match(line, asked)) {
          word = substr(line, RSTART, RLENGTH)
          line = substr(line, RSTART + RLENGTH)
          if (word ~ /^(law|vehicle_[0-9]+)/) { who = word; sub(/\..*/, "", who); if (who != "law") car[who] }
          if (word ~ /kind/) { sub(/.*[:= "]/, "", word); kind[who] = word }
        }
      }
      function offer(name,  rest, dot) {
        if (key != "" && name == key) { for (i = 3; i <= NF; i++) if ($i == "CAR") for (c in car) print c; else print $i }
        if (key != "" || index(name, cur) != 1) return
        rest = substr(name, length(cur) + 1)
        dot = index(rest, ".")
        name = dot ? cur substr(rest, 1, dot) : name "="
        if (!(name in said)) { said[name]; print name }
      }
      BEGIN { key = ENVIRON["key"]; cur = ENVIRON["cur"]; only = "^(" ENVIRON["only"] ")" }
      !table && /^[a-z]/ { section = $0; sub(/:.*/, "", section); who = section }
      !table { sub(/#.*/, "") }
      !table && section == "law" { note($0, "kind: *\"?[a-z_]+") }
      !table && section ~ /^(initial|drivers)$/ { note($0, "vehicle_[0-9]+|kind: *\"?[a-z_]+") }
      !table { next }
      !begun++ {
        note(ENVIRON["line"], "(law|vehicle_[0-9]+)\\.kind *= *\"?[a-z_]+")
        if (!known) { car["vehicle_1"]; car["vehicle_2"] }
        if (known && !("law" in kind)) kind["law"] = "opinion_dynamics"
        any = !("law" in kind)
      }
      $2 !~ only { next }
      { of = $1; sub(/:.*/, "", of); asked = $1; sub(/.*:/, "", asked) }
      of == "-" || of == "law" && (any || kind["law"] == asked) { offer($2) }
      of == "car" {
        for (c in car) if (asked == "-" || kind[c] == asked || !known && kind[c] == "") {
          name = $2
          sub(/CAR/, c, name)
          offer(name)
        }
      }
    ' known="${found:+1}" "${found:-/dev/null}" table=1 -
}

_mjmerge() {
  local cur=${COMP_WORDS[COMP_CWORD]} at=$COMP_CWORD before set= pre= offer= flags= keys= many= word rest
  case $cur in  # bash takes KEY=VALUE apart, zsh does not
    =) at=$((at - 1)); set=${COMP_WORDS[at]}; cur= ;;
    *=*) set=${cur%%=*}; cur=${cur#*=}; pre=$set= ;;
    *) if [ "${COMP_WORDS[at-1]}" = = ]; then at=$((at - 2)); set=${COMP_WORDS[at]}; fi ;;
  esac
  before=${COMP_WORDS[at-1]}
  case $set in --*) before=$set; set= ;; esac
  if [ "$COMP_CWORD" -eq 1 ]; then
    offer="@commands@" flags="--help --version"
  else
    case ${COMP_WORDS[1]}:$before in
@cases@
    esac
  fi
  if [ -n "$set$many" ]; then  # of a list, the last
    rest=${cur##*[,+]}
    pre=$pre${cur%"$rest"}
    cur=$rest
  fi
  case $cur in
    -*) offer=$flags ;;
    *) [ -z "$keys" ] || offer=$(_mjmerge_keys "$set" "$cur" "$keys") ;;
  esac
  COMPREPLY=()
  for word in $(compgen -W "$offer" -- "$cur"); do
    case $word in *[.=]) ;; *) word="$word " ;; esac
    COMPREPLY+=("$pre$word")
  done
  [ ${#COMPREPLY[@]} -gt 0 ] || compopt +o nospace 2>/dev/null
}
complete -o default -o nospace -F _mjmerge mjmerge
