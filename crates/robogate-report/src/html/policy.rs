//! The Content-Security-Policy of a page.

use std::collections::BTreeSet;

use base64ct::{Base64, Encoding};
use sha2::{Digest, Sha256};

/// The policy of a page with this body, this script after it and this style sheet before it.
///
/// Only the scripts, style sheets and style attributes that the page contains are used, each named by its SHA-256. A script
/// or style that came from data, should the escaping of text ever fail, has no effect. The page loads nothing and sends
/// nothing. Scripts set styles through the object model, which a policy does not restrict.
pub(super) fn of(body: &str, script: Option<&str>, style: &str) -> String {
    with(body, script, style, "")
}

/// The policy of a page that also reads data from the server that it came from, and that no other page may frame.
pub(super) fn of_served(body: &str, style: &str) -> String {
    with(body, None, style, "; connect-src 'self'; frame-ancestors 'none'")
}

fn with(body: &str, script: Option<&str>, style: &str, more: &str) -> String {
    let name = |text: &str| format!("'sha256-{}'", Base64::encode_string(&Sha256::digest(text)));
    let hashes: Vec<String> = scripts(body).chain(script).map(name).collect();
    let scripts = if hashes.is_empty() { "'none'".to_owned() } else { hashes.join(" ") };
    let attributes: BTreeSet<&str> = style_attributes(body).collect();
    let mut styles = name(style);
    if !attributes.is_empty() {
        styles.push_str(" 'unsafe-hashes'");
        attributes.iter().for_each(|text| styles.extend([" ", &name(text)]));
    }
    format!(
        "default-src 'none'; script-src {scripts}; style-src {styles}; img-src data: blob:; base-uri 'none'; \
         form-action 'none'{more}"
    )
}

/// The values of the style attributes in a body. They consist of our own words and numbers, without escaped characters.
///
/// Text from data cannot contain the attribute, because its quotes are escaped.
fn style_attributes(body: &str) -> impl Iterator<Item = &str> {
    body.split(" style=\"").skip(1).filter_map(|rest| Some(rest.split_once('"')?.0))
}

/// The inline scripts of a body. Blocks of data (`type="application/json"`) do not run and need no hash.
///
/// Text from data cannot contain the tag, because it is escaped.
fn scripts(body: &str) -> impl Iterator<Item = &str> {
    body.split("<script>").skip(1).filter_map(|rest| Some(rest.split_once("</script>")?.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_script_has_its_hash() {
        // SHA-256 of "alert(1)" in base64, as browsers compute it.
        let of = |text: &str| format!("'sha256-{}'", Base64::encode_string(&Sha256::digest(text)));
        let body = "<p>x</p><script>alert(1)</script><script type=\"application/json\">{}</script>";
        let policy = super::of(body, Some("more()"), "p {}");
        assert!(policy.contains(&format!("script-src {} {};", of("alert(1)"), of("more()"))), "{policy}");
        assert!(!policy.contains(&of("{}")) && !policy.contains("script-src 'unsafe-inline'"));
        assert!(super::of("<p>no script</p>", None, "").contains("script-src 'none'"));
    }
    #[test]
    fn each_style_has_its_hash() {
        let of = |text: &str| format!("'sha256-{}'", Base64::encode_string(&Sha256::digest(text)));
        let body = "<svg style=\"--w:640\"></svg><svg style=\"--w:640\"></svg><i style=\"display:block\"> style=&quot;x&quot;</i>";
        let policy = super::of(body, None, "p {}");
        let expected = ["p {}", "--w:640", "display:block"].map(of);
        let styles = format!("style-src {} 'unsafe-hashes' {} {};", expected[0], expected[1], expected[2]);
        assert!(policy.contains(&styles), "{policy}");
        assert!(!policy.contains("unsafe-inline"));
        assert!(super::of("<p>text</p>", None, "").contains(&format!("style-src {};", of(""))));
    }
}
