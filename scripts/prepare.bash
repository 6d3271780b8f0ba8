# Sourced by the scripts beside it: puts in place what cargo cannot, on Debian and Ubuntu by apt-get, elsewhere by
# saying what is needed.

say() { printf '%s: %s\n' "${0##*/}" "$*" >&2; }

die() {
    say "$*"
    exit 1
}

as_root() {
    if [ "$(id -u)" -eq 0 ]; then "$@"
    elif command -v sudo >/dev/null 2>&1; then sudo "$@"
    else
        say "this needs root: run it as root or install sudo"
        return 1
    fi
}

# install PACKAGE...; fails where there is no apt-get.
install() {
    command -v apt-get >/dev/null 2>&1 || return 1
    say "installing $*"
    as_root apt-get update -q || return 1
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -qy --no-install-recommends "$@"
}

need_cargo() {
    # A fresh rustup may not be on the PATH of this shell yet.
    command -v cargo >/dev/null 2>&1 || PATH="${CARGO_HOME:-$HOME/.cargo}/bin:$PATH"
    command -v cargo >/dev/null 2>&1 || die "cargo is missing: install Rust with rustup (https://rustup.rs)"
    cargo --version >/dev/null 2>&1 || die "cargo does not run: choose a toolchain with 'rustup default stable'"
}

# Rust needs a C compiler to link with, and nothing else of C.
need_linker() {
    command -v cc >/dev/null 2>&1 && return
    install gcc libc6-dev || die "there is no C linker (cc): install gcc or clang with the C library's headers"
}

has_vulkan() {
    case "$(uname -s)" in
        Linux) ;;
        *) return 0 ;; # Metal and DX12 come with the system.
    esac
    local libraries loader
    libraries="$(PATH="$PATH:/usr/sbin:/sbin" ldconfig -p 2>/dev/null || true)"
    case "$libraries" in
        *libvulkan.so.1*) loader=yes ;;
        *) loader="$(ls /usr/lib*/libvulkan.so.1 /usr/lib/*/libvulkan.so.1 2>/dev/null || true)" ;;
    esac
    [ -n "$loader" ] || return 1
    [ -z "${VK_DRIVER_FILES:-}${VK_ICD_FILENAMES:-}" ] || return 0
    local folder
    for folder in /usr/share /usr/local/share /etc "${XDG_DATA_HOME:-$HOME/.local/share}"; do
        compgen -G "$folder/vulkan/icd.d/*.json" >/dev/null && return 0
    done
    return 1
}

# lavapipe, a Vulkan driver that runs on the CPU, where there is no driver at all.
want_vulkan() {
    has_vulkan && return
    install mesa-vulkan-drivers libvulkan1 && has_vulkan && return
    say "there is no Vulkan driver, so tests of the GPU backend cannot run: install Mesa's Vulkan drivers (lavapipe) and the Vulkan loader"
}

# Some drivers complain or fail without this folder. The caller removes $temporary.
want_runtime_folder() {
    temporary=""
    [ -n "${XDG_RUNTIME_DIR:-}" ] && return
    temporary="$(mktemp -d)"
    export XDG_RUNTIME_DIR="$temporary"
}
