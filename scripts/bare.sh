#!/usr/bin/env bash
# Makes a minimal Debian with python3, python3-venv, make and git, and runs the two commands of the README in it, as an
# ordinary user. Nothing of this machine is there but the names of hosts and the configuration of pip.
#   scripts/bare.sh [FOLDER [COMMAND]]
# A FOLDER keeps the system for the next time; without one (or with "") it is a temporary one. COMMAND replaces the two
# commands. Needs root. Where such a system cannot be made, one line says why, and the exit code is 77.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
folder="${1:-}"
command="${2:-make demo && make test}"

cannot() {
  echo "no bare system here: $1"
  exit 77
}

[ "$(id -u)" = 0 ] || cannot "debootstrap and chroot need root"
command -v apt-get >/dev/null || cannot "there is no apt, which names the source of Debian's packages"
command -v debootstrap >/dev/null ||
  DEBIAN_FRONTEND=noninteractive timeout 300 sh -c 'apt-get update && apt-get install -y --no-install-recommends debootstrap' >/dev/null 2>&1 ||
  cannot "debootstrap cannot be installed"
apart=(unshare --mount --pid --fork --kill-child --propagation private)
"${apart[@]}" true 2>/dev/null || cannot "unshare does not work, a part of a container without rights?"

if [ -z "$folder" ]; then
  folder="$(mktemp -d)"
  trap 'rm -rf --one-file-system "$folder"' EXIT
fi
mkdir -p "$folder"
system="$(realpath "$folder")/system"

# The system is of the release that this machine is of, from where apt of this machine takes its packages.
if [ ! -e "$system/.is-complete" ]; then
  read -r site release < <(apt-get indextargets --format '$(SITE) $(RELEASE)' 'Created-By: Packages') ||
    cannot "apt has no source of packages"
  components="$(apt-get indextargets --format '$(SITE) $(RELEASE) $(COMPONENT)' 'Created-By: Packages' |
    awk -v of="$site $release" '$1 " " $2 == of {print $3}' | sort -u | paste -sd,)"
  rm -rf --one-file-system "$system"
  debootstrap --variant=minbase --components="$components" --include=python3,python3-venv,make,git \
    "$release" "$system" "$site" >"$folder/debootstrap.log" 2>&1 ||
    { tail -n 5 "$folder/debootstrap.log"; cannot "debootstrap fails, see above"; }
  rm -f "$system"/var/cache/apt/archives/*.deb
  chroot "$system" useradd --create-home --shell /bin/bash robot || cannot "chroot does not work"
  touch "$system/.is-complete"
fi
cp -L /etc/resolv.conf /etc/hosts "$system/etc/"

# The tree as it is, without what git ignores.
home="$system/home/robot"
rm -rf --one-file-system "$home/slidectl"
mkdir -p "$home/slidectl"
git ls-files -z --cached --others --exclude-standard |
  tar --create --null --ignore-failed-read --files-from=- 2>/dev/null | tar --extract --directory "$home/slidectl"

# pip is configured as on this machine: its variables, its files, and what both name. The packages of an index in a
# folder are beside it.
variables=()
while IFS= read -r -d '' variable; do
  case "${variable%%=*}" in
    PIP_CACHE_DIR | PIP_CONFIG_FILE | PIP_REQUIRE_VIRTUALENV) ;;
    PIP_* | http_proxy | https_proxy | no_proxy | HTTP_PROXY | HTTPS_PROXY | NO_PROXY) variables+=("$variable") ;;
  esac
done < <(env --null)
configuration=()
for file in /etc/pip.conf /etc/xdg/pip/pip.conf; do
  [ ! -e "$file" ] || { install -D -m 644 "$file" "$system$file" && configuration+=("$file"); }
done
for file in "${PIP_CONFIG_FILE:-}" "${XDG_CONFIG_HOME:-$HOME/.config}/pip/pip.conf" "$HOME/.pip/pip.conf"; do
  [ ! -f "$file" ] || { install -D -m 644 "$file" "$home/.config/pip/pip.conf" && configuration+=("$file") && break; }
done
mapfile -t shared < <({ printf '%s\n' ${variables[@]+"${variables[@]}"}; cat /dev/null ${configuration[@]+"${configuration[@]}"}; } |
  grep -oE '(^|[= ]|file://)/[^ ]+' | sed -E 's,^[= ],,; s,^file://(.*)/simple/?$,\1,; s,^file://,,' | sort -u)
chroot "$system" chown -R robot:robot /home/robot

inside() {  # in namespaces of its own: mounts and processes end with it
  local system="$1" command="$2" path
  shift 2
  mount -t proc proc "$system/proc"
  mount --rbind /dev "$system/dev"
  while [ "$1" != -- ]; do
    path="$1"
    shift
    [ -e "$path" ] || continue
    if [ -d "$path" ]; then mkdir -p "$system$path"; else mkdir -p "$system$(dirname "$path")" && touch "$system$path"; fi
    mount --bind "$path" "$system$path"
  done
  shift
  chroot --userspec=robot:robot "$system" env -i HOME=/home/robot USER=robot PATH=/usr/local/bin:/usr/bin:/bin "$@" \
    bash -c "cd && cd slidectl && $command"
}
"${apart[@]}" bash -c "set -euo pipefail; $(declare -f inside); inside \"\$@\"" bash "$system" "$command" \
  ${shared[@]+"${shared[@]}"} -- ${variables[@]+"${variables[@]}"} </dev/null
