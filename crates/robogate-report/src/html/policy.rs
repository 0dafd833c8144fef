//! The Content-Security-Policy of a page.

use sha2::{Digest, Sha256};

/// The policy of a page with this body and this script after it.
///
/// Only the scripts that the page contains may run, each named by its SHA-256. A script that came from data, should the
/// escaping of text ever fail, does not run. The page loads nothing and sends nothing. Styles stay inline: the figures
/// set custom properties in attributes, which a policy cannot name one by one.
pub(super) fn of(body: &str, script: Option<&str>) -> String {
    with(body, script, "")
}

/// The policy of a page that also reads data from the server that it came from, and that no other page may frame.
pub(super) fn of_served(body: &str) -> String {
    with(body, None, "; connect-src 'self'; frame-ancestors 'none'")
}

fn with(body: &str, script: Option<&str>, more: &str) -> String {
    let hashes: Vec<String> =
        scripts(body).chain(script).map(|text| format!("'sha256-{}'", base64(&Sha256::digest(text)))).collect();
    let scripts = if hashes.is_empty() { "'none'".to_owned() } else { hashes.join(" ") };
    format!(
        "default-src 'none'; script-src {scripts}; style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; \
         form-action 'none'{more}"
    )
}

/// The inline scripts of a body. Blocks of data (`type="application/json"`) do not run and need no hash.
///
/// Text from data cannot contain the tag, because it is escaped.
fn scripts(body: &str) -> impl Iterator<Item = &str> {
    body.split("<script>").skip(1).filter_map(|rest| Some(rest.split_once("</script>")?.0))
}

/// Base64 (RFC 4648) of a hash, whose length leaves a remainder of two bytes.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(44);
    for chunk in bytes.chunks(3) {
        let group = (0..3).fold(0_usize, |sum, i| (sum << 8) | usize::from(chunk.get(i).copied().unwrap_or_default()));
        for i in 0..4 {
            let digit = DIGITS[(group >> (18 - 6 * i)) & 63];
            text.push(if i <= chunk.len() { char::from(digit) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_matches_the_standard() {
        // Test vectors of RFC 4648, section 10.
        for (bytes, text) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")] {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
    }

    #[test]
    fn each_script_has_its_hash() {
        // SHA-256 of "alert(1)" in base64, as browsers compute it.
        let of = |text: &str| format!("'sha256-{}'", base64(&Sha256::digest(text)));
        let body = "<p>x</p><script>alert(1)</script><script type=\"application/json\">{}</script>";
        let policy = super::of(body, Some("more()"));
        assert!(policy.contains(&format!("script-src {} {};", of("alert(1)"), of("more()"))), "{policy}");
        assert!(!policy.contains(&of("{}")) && !policy.contains("script-src 'unsafe-inline'"));
        assert!(super::of("<p>no script</p>", None).contains("script-src 'none'"));
    }
}
