# shellcheck shell=bash disable=SC2154 # project, cache, suite, kind, tree, venv, home, host_python and solver are set by dev
# Makes environments: a private Debian tree with mmdebstrap, and a virtual environment of wheels. Read by ./dev.
# A folder under its final name is complete: it is made as NAME.partial and renamed, by one maker at a time, who holds a lock.

mirror=${BCID_MIRROR:-http://deb.debian.org/debian}
maker=''

# Where a user makes a tree: subordinate ids must get at it, which they often cannot in a home folder.
scratch=/var/tmp/bcid-$EUID-$(hash_of <<<"$cache")

readonly MORE_ROOM="Make room (./dev clean deletes old environments), or set BCID_CACHE to a folder on a larger disk."
readonly OR_WHEELS="Python 3.12 or newer with its headers, and a C compiler; then wheels do."

make_missing() {
    lock
    trap 'interrupted 130' INT
    trap 'interrupted 143' TERM HUP
    tidy
    [ "$kind" = host ] || [ -d "$tree" ] || make_tree
    [ -d "$venv" ] || make_venv
    trap - INT TERM HUP
    exec 9>&-
}

# Waits for the lock of another maker. What a maker starts inherits it: it is free only when nothing is made any more.
lock() {
    { mkdir -p -- "$cache/log" && exec 9>"$cache/lock"; } 2>/dev/null || no_cache
    flock -n 9 && return
    say "another ./dev is building; waiting for it to finish"
    flock 9
}

interrupted() {
    [ -z "$maker" ] || { kill -KILL -- "-$maker" && wait "$maker"; } 2>/dev/null
    tidy
    say "interrupted; nothing half-built was kept"
    exit "$1"
}

# Removes what is half made.
tidy() {
    remove "$cache"/*.partial
    [ ! -d "$scratch" ] || mmdebstrap --unshare-helper rm -rf -- "$scratch" 2>/dev/null
    rm -rf -- "$scratch"
}

# Removes folders, also those without write permissions.
remove() {
    chmod -R u+rwX -- "$@" 2>/dev/null
    rm -rf --one-file-system -- "$@"
}

# make FOLDER WHAT STEP...: runs a step that fills FOLDER.partial, and gives it its name.
make() {
    local start=$SECONDS partial=$1.partial log=$cache/log/${1##*/}.log
    mkdir -p -- "$partial" || no_cache
    guarded "${@:3}" || explain_failure "$2"
    mv -- "$partial" "$1" || explain_failure "$2"
    say "$2 made in $((SECONDS - start)) s"
}

# need_space MB FOLDER: refuses to begin what the disk cannot hold: what is unpacked plus what is downloaded on the way.
need_space() {
    local free
    free=$(df -Pm -- "$2" | awk 'NR == 2 {print $4}')
    [ "${free:-0}" -ge "$1" ] || die "not enough disk space: $1 MB are needed in $2, ${free:-0} MB are free." "$MORE_ROOM"
}

# Runs a step in a process group of its own, which is killed when this script dies, however it dies.
guarded() {
    set -m
    (
        set +m
        (while kill -0 $$ 2>/dev/null; do sleep 0.5 9>&-; done; kill -KILL 0) &
        ("$@")
        rc=$?
        kill -KILL $!
        exit "$rc"
    ) </dev/null >"$log" 2>&1 &
    maker=$!
    set +m
    wait "$maker"
}

# Turns the log of a failed step into one message.
explain_failure() {
    local lost='Could not resolve|Temporary failure|Name or service not known|NameResolution|[Cc]onnect|unreachable|timed out'
    tidy
    if grep -qE 'No space left on device|not enough free space|Errno 28' "$log"; then
        die "the disk filled up while making $1; what was made of it is removed." "$MORE_ROOM" "Log: $log"
    elif grep -qE "$lost" "$log"; then
        die "making $1 failed for lack of network: $(grep -m1 -E "$lost" "$log")" \
            "Check the network; behind a proxy set http_proxy and https_proxy; another Debian mirror: BCID_MIRROR; another" \
            "package index: PIP_INDEX_URL. Then run ./dev again." "Log: $log"
    fi
    die "making $1 failed. The end of the log:" "$(tail -n 15 -- "$log" | sed 's/^/    /')" "Log: $log"
}

make_venv() {
    local script=$project/environment/make_venv.sh step
    step=(bash "$script" "$host_python" "$venv.partial/venv" "$solver")
    [ "$kind" = host ] || step=(sandbox bash "$script" /usr/bin/python3 /run/bcid/venv own)
    need_space 1600 "$cache"
    mkdir -p -- "$venv.partial/venv" "$home" || no_cache
    say "installing the pinned wheels (about 30 s)"
    make "$venv" "the venv" "${step[@]}"
}

make_tree() {
    need_tools
    need_space 4300 "$cache"
    if [ "$EUID" != 0 ]; then
        need_space 4300 /var/tmp
        mkdir -m 1777 -- "$scratch" || die "cannot write to /var/tmp, where a tree is made."
    fi
    say "making a private Debian $suite tree in $cache (760 MB to download, about 2 minutes)"
    make "$tree" "the Debian tree" debian_tree
    tidy
}

debian_tree() {
    local options include
    mapfile -t options < <(mmdebstrap_options)
    include=$(packages | paste -sd, -)
    mkdir -- "$partial/root" || return
    if [ "$EUID" = 0 ]; then
        # In namespaces of its own: whenever it is killed, its mounts and all its processes go with it.
        unshare --mount --pid --fork --kill-child --mount-proc \
            mmdebstrap --mode=root "${options[@]}" --include="$include" "$suite" "$partial/root" "$mirror" || return
    else
        # As a tar stream, so that the files end up belonging to the user and not to subordinate ids.
        TMPDIR=$scratch mmdebstrap --mode=unshare --format=tar "${options[@]}" --include="$include" "$suite" - "$mirror" |
            tar -x --no-same-owner --exclude=./dev -C "$partial/root" || return
    fi
    # The machine's own files are mounted over these.
    local f
    for f in resolv.conf hosts localtime pip.conf passwd group ssl/certs/ca-certificates.crt; do
        rm -f -- "$partial/root/etc/$f" && : >"$partial/root/etc/$f" || return
    done
}

tree_hash() { (declare -f debian_tree; packages; mmdebstrap_options) | hash_of; }

packages() { plain debian.txt; }

# Documentation, static libraries and Boost's headers are a quarter of the size and are not used.
mmdebstrap_options() {
    printf '%s\n' --variant=apt --aptopt='APT::Install-Recommends "false"' --aptopt='Acquire::Languages "none"' \
        --aptopt='Acquire::Retries "3"' --dpkgopt=force-unsafe-io
    printf -- '--dpkgopt=path-%s\n' exclude=/usr/share/{doc,man,info,locale,javascript}/'*' exclude=/usr/include/boost/'*' \
        exclude=/usr/lib/'*.a' include=/usr/lib/gcc/'*' include=/usr/lib/'*'/libc_nonshared.a
    # The archive of unstable is often older than its own expiry date where mirrors are cached.
    [ "$suite" = trixie ] || echo '--aptopt=Acquire::Check-Valid-Until "false"'
}

# The programs that make a tree, and the namespaces they live in.
need_tools() {
    local missing=() log=$cache/log/apt.log out user
    user=$(id -un)
    type -P mmdebstrap >/dev/null || missing+=(mmdebstrap)
    type -P bwrap >/dev/null || missing+=(bubblewrap)
    [ -e /usr/share/keyrings/debian-archive-keyring.gpg ] || missing+=(debian-archive-keyring)
    [ "$EUID" = 0 ] || type -P newuidmap >/dev/null || missing+=(uidmap)
    if [ ${#missing[@]} -gt 0 ] && [ "$EUID" = 0 ] && type -P apt-get >/dev/null; then
        say "installing ${missing[*]} on this machine with apt-get"
        { apt-get update && apt-get install -y --no-install-recommends "${missing[@]}"; } >"$log" 2>&1 </dev/null ||
            explain_failure "the tools to build with (${missing[*]})"
    elif [ ${#missing[@]} -gt 0 ]; then
        die "no DOLFINx was found, and making an environment needs what this machine does not have: ${missing[*]}." \
            "On Debian or Ubuntu:   sudo apt-get install ${missing[*]}" "Elsewhere:             $OR_WHEELS"
    fi
    out=$(bwrap --ro-bind / / --dev /dev --unshare-pid --proc /proc true 2>&1) ||
        die "bubblewrap cannot make namespaces here: $out" \
            "In a container: start it with --privileged. On a machine: the administrator allows user namespaces with" \
            "  sysctl kernel.unprivileged_userns_clone=1   (Ubuntu: sysctl kernel.apparmor_restrict_unprivileged_userns=0)" \
            "Without either: $OR_WHEELS"
    [ "$EUID" = 0 ] || { getsubids "$user" && getsubids -g "$user"; } >/dev/null 2>&1 ||
        die "this user has no subordinate user ids, which a tree needs. The administrator adds them with" \
            "  sudo usermod --add-subuids 100000-165535 --add-subgids 100000-165535 $user" "Without them: $OR_WHEELS"
}
