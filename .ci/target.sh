# To be sourced: `for_target ARGUMENTS...` calls cargo for the chip and sets `folder` to where its images
# lie. Uses rustup's target where it is installed, else (or with COMPILER=debian) Debian's compiler with
# the sources of `core`.
target=thumbv7em-none-eabihf
unset RUSTFLAGS
root=$PWD

for_target() {
    if [ "${COMPILER:-}" != debian ] && [ -d "$(rustc --print target-libdir --target $target)" ]; then
        cargo "$@" --locked
        folder=target/$target/image
        return
    fi
    local compiler=${DEBIAN_RUSTC:-/usr/bin/rustc} sources='' host linker
    [ ! -x "$compiler" ] || sources="$("$compiler" --print sysroot)/lib/rustlib/src/rust/library/core"
    [ -d "$sources" ] || {
        echo "need: rustup target add $target (or: apt-get install rustc-web cargo-web rust-web-src)" >&2
        exit 1
    }
    # Debian's compiler has no rust-lld: borrow rustup's, else GNU ld.
    host=$(rustc -vV | sed -n 's/^host: //p')
    linker="$(rustc --print sysroot)/lib/rustlib/$host/bin/rust-lld"
    [ -x "$linker" ] || linker=$(command -v ld.lld)
    RUSTC=$compiler RUSTC_BOOTSTRAP=1 CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER=$linker \
        cargo "$@" --locked -Zbuild-std=core --target-dir "$root/target/debian"
    folder=target/debian/$target/image
}
