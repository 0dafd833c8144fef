//! Who may send requests: names of this machine, and tokens.

use std::net::{Ipv4Addr, Ipv6Addr};

/// Whether the value of a Host header names this machine (RFC 9110, section 7.2: `host [ ":" port ]`). Anything else in it,
/// as in `[::1].example.com`, is another name.
pub(super) fn is_this_machine(host: &str) -> bool {
    let is_port = |text: &str| text.is_empty() || text.parse::<u16>().is_ok();
    match host.strip_prefix('[') {
        Some(rest) => rest.split_once(']').is_some_and(|(address, rest)| {
            let port = rest.is_empty() || rest.strip_prefix(':').is_some_and(is_port);
            port && address.parse::<Ipv6Addr>().is_ok_and(|address| address.is_loopback())
        }),
        None => {
            let (name, port) = host.split_once(':').unwrap_or((host, ""));
            let local = name.eq_ignore_ascii_case("localhost");
            is_port(port) && (local || name.parse::<Ipv4Addr>().is_ok_and(|address| address.is_loopback()))
        }
    }
}

/// Compares two tokens in constant time.
pub(super) fn same(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |sum, (a, b)| sum | (a ^ b)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_local_hosts_are_this_machine() {
        for host in ["localhost", "LOCALHOST:80", "127.0.0.1", "127.9.9.9:8080", "[::1]", "[::1]:8080"] {
            assert!(is_this_machine(host), "{host}");
        }
        for host in [
            "",
            "[::1].evil.com",
            "[::1]evil.com:80",
            "[::1]:80.evil.com",
            "[::1",
            "localhost.evil.com",
            "localhost:80.evil.com",
            "127.0.0.1.evil.com",
            "127.0.0.1:80:90",
            "user@localhost",
            "localhost@evil.com",
            "10.0.0.1",
            "[::2]",
            "[127.0.0.1]",
            "::1",
        ] {
            assert!(!is_this_machine(host), "{host}");
        }
    }
}
