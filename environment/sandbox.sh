# shellcheck shell=bash disable=SC2154 # project, cache, tree, venv and home are set by dev
# Runs a command in the private Debian tree, with bubblewrap. Read by ./dev.

# sandbox CMD...: replaces this process by CMD in the tree.
sandbox() {
    local d f here passwd group root=$tree/root certificates=/etc/ssl/certs/ca-certificates.crt
    local args=(--die-with-parent --unshare-pid --dev /dev --proc /proc)
    here=$(pwd -P)
    args+=(--ro-bind-try /sys /sys --ro-bind "$root/etc" /etc --ro-bind "$root/var/lib/dpkg" /var/lib/dpkg)
    # The root is an empty tmpfs and not the tree, so that folders to mount on can be made in it.
    for d in "$root"/{bin,sbin,lib*}; do
        [ ! -L "$d" ] || args+=(--symlink "usr/${d##*/}" "/${d##*/}")
    done
    for d in "$root"/usr/*; do
        # Left out because a clone may live there on the machine.
        case $d in */local | */src) ;; *) args+=(--ro-bind "$d" "/usr/${d##*/}") ;; esac
    done
    # Everything that is not part of the machine's system may hold data: at its own place, for who may read or write it.
    for d in /* /run/media /var/*; do
        case $d in
        /bin | /sbin | /lib | /lib32 | /lib64 | /libx32 | /usr | /etc | /dev | /proc | /sys | /run | /boot) continue ;;
        /lost+found | /var | /var/lib | /var/run | /var/lock) continue ;;
        esac
        [ ! -L "$d" ] || args+=(--symlink "$(readlink -- "$d")" "$d")
        [ -L "$d" ] || [ ! -d "$d" ] || args+=(--bind-try "$d" "$d")
    done
    args+=(--dir /var/tmp --dir /run/bcid --tmpfs /run/bcid/tmp)
    # Names, time zone, certificates and package index of the machine.
    for f in resolv.conf hosts localtime pip.conf; do
        [ ! -f "/etc/$f" ] || args+=(--ro-bind "$(readlink -f "/etc/$f")" "/etc/$f")
    done
    for f in "${SSL_CERT_FILE:-}" "${PIP_CERT:-}" "${REQUESTS_CA_BUNDLE:-}" "$certificates" /etc/pki/tls/certs/ca-bundle.crt \
        /etc/ssl/ca-bundle.pem /etc/ssl/cert.pem; do
        [ -r "$f" ] && args+=(--ro-bind "$(readlink -f "$f")" "$certificates") && break
    done
    # These may lie in a folder that is left out above.
    for d in "$project" "$home" "$here" "$(readlink -f -- "${HOME:-/}")"; do
        of_the_tree "$d" || args+=(--bind-try "$d" "$d")
    done
    # The environment lies in a folder of the user's, and other clones use it.
    for d in "$cache"/{tree,venv}-*; do
        [ ! -d "$d" ] || [ "${d%.partial}" != "$d" ] || args+=(--ro-bind "$d" "$d")
    done
    args+=(--bind-try "$venv.partial/venv" /run/bcid/venv --ro-bind-try "$venv/venv" /run/bcid/venv)
    passwd=$'root:x:0:0:root:/root:/bin/bash\n'"$(id -un):x:$EUID:$(id -g)::${HOME:-/}:/bin/bash"
    group=$'root:x:0:\n'"$(id -gn):x:$(id -g):"
    args+=(--ro-bind-data 5 /etc/passwd --ro-bind-data 6 /etc/group --remount-ro / --chdir "$here")
    clean_variables
    # bubblewrap would be killed by a signal and take CMD with it. It ignores them, CMD does not, and enter_tree passes them on.
    trap '' INT QUIT TERM HUP
    exec "$bwrap" "${args[@]}" /usr/bin/env --default-signal=INT,QUIT,TERM,HUP -- "$@" 7<&- 8<&- 5<<<"$passwd" 6<<<"$group"
}

# Does this folder belong to what is the tree's, inside?
of_the_tree() { [[ $1 =~ ^/((usr/(bin|lib|sbin|share)|etc|proc|dev|sys).*|usr)?$ ]]; }

# Variables of the machine that would mislead programs in the tree. All others go in, as proxies, PIP_*, OMP_*, PETSC_OPTIONS.
clean_variables() {
    bwrap=$(type -P bwrap) || die "bubblewrap (the command bwrap) is not installed any more."
    unset PYTHONPATH PYTHONHOME PYTHONSTARTUP PYTHONUSERBASE PYTHONPLATLIBDIR PYTHONPYCACHEPREFIX VIRTUAL_ENV
    unset LD_LIBRARY_PATH LD_PRELOAD LD_AUDIT LIBRARY_PATH CPATH C_INCLUDE_PATH CPLUS_INCLUDE_PATH PKG_CONFIG_PATH
    unset CC CXX CPP LD AR CFLAGS CXXFLAGS CPPFLAGS LDFLAGS PETSC_DIR PETSC_ARCH SLEPC_DIR OPAL_PREFIX PERL5LIB GCONV_PATH
    unset BASH_ENV ENV CDPATH PROMPT_COMMAND LANGUAGE LC_ALL LOCPATH TMP TEMP MANPATH SSL_CERT_DIR
    unset XDG_RUNTIME_DIR XDG_DATA_DIRS XDG_CONFIG_DIRS XDG_STATE_HOME DBUS_SESSION_BUS_ADDRESS
    unset "${!CONDA@}" "${!PYENV@}" "${!LC_@}" "${!LMOD@}" 2>/dev/null
    export LANG=C.UTF-8 SHELL=/bin/bash TMPDIR=/run/bcid/tmp PYTHONNOUSERSITE=1 PATH=/run/bcid/venv/bin:/usr/bin:/usr/sbin
    export SSL_CERT_FILE=$certificates PIP_CERT=$certificates REQUESTS_CA_BUNDLE=$certificates CURL_CA_BUNDLE=$certificates
}

# enter_tree CMD...: runs CMD in the tree and returns its exit code. Signals sent to this script reach CMD once: at a terminal it
# shares this script's process group and gets Ctrl-C by itself, otherwise it has a group of its own.
enter_tree() {
    local rc child
    trap 'forward TERM' TERM
    trap 'forward HUP' HUP
    if [ -t 0 ]; then
        trap : INT
    else
        trap 'forward INT' INT
        set -m
    fi
    (sandbox "$@") <&0 &
    child=$!
    set +m
    # wait also returns when a signal came; then CMD is still there.
    while wait "$child"; rc=$?; kill -0 "$child" 2>/dev/null; do :; done
    return "$rc"
}

# bubblewrap runs CMD as the child of a process that is number 1 of a new process namespace.
forward() {
    local pid=$child
    for _ in 1 2; do read -r pid _ <"/proc/$pid/task/$pid/children"; done
    kill "-$1" "$pid" || kill -KILL "$child"
} 2>/dev/null
