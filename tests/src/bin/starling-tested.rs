//! The binary under test, built by this package so that `cargo test` needs no other.

fn main() -> std::process::ExitCode {
    peer::cli::main()
}
