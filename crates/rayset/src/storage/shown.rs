//! Paths and texts as people may see them: without what an address grants access with.
//!
//! The secrets of an address are its user and password, its query and its fragment: signatures and tokens stand there. All that
//! leaves a process passes one of these functions: messages, reports, names of files, what is written into outputs. What has
//! to open an object again, such as a scene, keeps the whole address.

use std::borrow::Cow;
use std::path::Path;

/// A path, or an address without its secrets.
#[must_use]
pub fn shown(path: &Path) -> String {
    let text = path.to_string_lossy();
    without_secrets(&text, Extent::Whole).unwrap_or_else(|| text.into_owned())
}

/// A text with every address in it without its secrets. Each address ends at white space, at a double or backward quotation mark, or
/// at an angle bracket.
#[must_use]
pub fn redacted(text: &str) -> Cow<'_, str> {
    without_secrets(text, Extent::Word).map_or(Cow::Borrowed(text), Cow::Owned)
}

/// Up to where an address goes.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Extent {
    /// To the end of the text.
    Whole,
    /// To what cannot stand in an address.
    Word,
}

/// The text without secrets; `None` if it has none.
fn without_secrets(text: &str, extent: Extent) -> Option<String> {
    let mut out = String::new();
    let (mut rest, mut changed) = (text, false);
    while let Some(start) = Start::find(rest) {
        out.push_str(&rest[..start.at]);
        rest = &rest[start.at..];
        if let Some(user) = end_of_user(rest, extent) {
            rest = &rest[user + 1..];
            changed = true;
        }
        let (authority, end) = ends(rest, extent);
        if is_host(&rest[..authority]) {
            out.push_str(&rest[..authority]);
        } else {
            // A user and a password without a host.
            out.push_str(rest[..authority].split_inclusive(':').next().unwrap_or_default());
            out.push('…');
            out.push_str(marks_of_a_sentence(&rest[..authority]));
            changed = true;
        }
        let path = &rest[authority..end];
        let cut = path.find(['?', '#']).filter(|&cut| start.is_web || path[cut..].contains('='));
        let kept = &path[..cut.unwrap_or(path.len())];
        let inner = without_secrets(kept, extent);
        changed |= inner.is_some() || cut.is_some();
        out.push_str(inner.as_deref().unwrap_or(kept));
        if let (Some(cut), Extent::Word) = (cut, extent) {
            out.push_str(marks_of_a_sentence(&path[cut..]));
        }
        rest = &rest[end..];
    }
    out.push_str(rest);
    changed.then_some(out)
}

/// Where the host ends that a text begins with, and where the address does.
fn ends(text: &str, extent: Extent) -> (usize, usize) {
    let end = match extent {
        Extent::Whole => text.len(),
        Extent::Word => text.find(ends_word).unwrap_or(text.len()),
    };
    (text[..end].find(['/', '\\', '?', '#']).unwrap_or(end), end)
}

/// The place of the `@` before which user and password stand.
fn end_of_user(text: &str, extent: Extent) -> Option<usize> {
    let (authority, end) = ends(text, extent);
    if let Some(at) = text[..authority].rfind('@') {
        return Some(at);
    }
    if is_host(&text[..authority]) {
        return None;
    }
    // What looks like the host are a user and a password with a letter that ends hosts, or words.
    let bound = text.find("://").unwrap_or(text.len());
    let line = text.find('\n').unwrap_or(text.len());
    text[..end.min(bound)].rfind('@').or_else(|| text[..line.min(bound)].rfind('@'))
}

/// The marks of the sentence that an address stands in, which are taken for its end.
fn marks_of_a_sentence(text: &str) -> &str {
    &text[text.trim_end_matches([':', ',', ';', '.', ')', ']', '\'']).len()..]
}

/// Where what is behind the scheme of an address begins.
struct Start {
    at: usize,
    /// Of a web server.
    is_web: bool,
}

impl Start {
    /// The first address of a text. One slash does for a web server: paths that are tidied have one.
    fn find(text: &str) -> Option<Self> {
        text.match_indices(":/").find_map(|(colon, _)| {
            let of_scheme = |c: char| c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.');
            let scheme = &text[text[..colon].trim_end_matches(of_scheme).len()..colon];
            let slashes = text[colon + 1..].bytes().take_while(|&byte| byte == b'/').count();
            let lower = scheme.to_ascii_lowercase();
            let is_web = lower.ends_with("http") || lower.ends_with("https");
            let is_scheme = scheme.contains(|c: char| c.is_ascii_alphabetic());
            (is_web || is_scheme && slashes >= 2).then_some(Self { at: colon + 1 + slashes, is_web })
        })
    }
}

fn ends_word(c: char) -> bool {
    c.is_whitespace() || c.is_control() || matches!(c, '"' | '`' | '<' | '>')
}

/// Whether what stands before the path of an address is a host, with a port or without.
fn is_host(text: &str) -> bool {
    let after_brackets = text.rsplit_once(']').map_or(text, |(_, port)| port);
    let port = after_brackets.split_once(':').map_or("", |(_, port)| port);
    let port = &port[..port.len() - marks_of_a_sentence(port).len()];
    port.bytes().all(|byte| byte.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_of_addresses_are_not_shown_wherever_they_stand() {
        for (text, expected) in [
            ("https://host/a.rset", "https://host/a.rset"),
            ("https://user:hunter2@host:81/a%20b.rset?sig=hunter2#hunter2", "https://host:81/a%20b.rset"),
            ("HTTPS://hunter2@host/a?hunter2", "HTTPS://host/a"),
            // As tidied paths have it.
            ("https:/user:hunter2@host/a?sig=hunter2", "https:/host/a"),
            ("/here/https:/user:hunter2@host/a", "/here/https:/host/a"),
            // Passwords with letters that end a host.
            ("https://user:hunter2/hunter2@host/a", "https://host/a"),
            ("https://user:hunter2?hunter2@host/a", "https://host/a"),
            ("https://user:p@hunter2@host/a", "https://host/a"),
            ("https://user:hunter2", "https://user:…"),
            ("https://[::1]:80/a?hunter2", "https://[::1]:80/a"),
            ("https://[::1]/a", "https://[::1]/a"),
            // Addresses within addresses.
            ("https://proxy/https://user:hunter2@host/a", "https://proxy/https://host/a"),
            // Keys of buckets may have question marks; signatures have a name.
            ("s3://bucket/a?b#c.rset", "s3://bucket/a?b#c.rset"),
            ("az://box/blob?sv=1&sig=hunter2", "az://box/blob"),
            ("s3://key:hunter2@bucket/a", "s3://bucket/a"),
            ("/data/a?b=c@d.las", "/data/a?b=c@d.las"),
            ("C:\\data\\a", "C:\\data\\a"),
            ("file: /a?b=c", "file: /a?b=c"),
        ] {
            assert_eq!(shown(Path::new(text)), expected, "{text}");
            assert_eq!(redacted(text), expected, "{text}");
            let within = format!("cannot read \"{text}\": of `{text}` ({text}); {text}, <{text}>");
            let without =
                format!("cannot read \"{expected}\": of `{expected}` ({expected}); {expected}, <{expected}>");
            assert_eq!(redacted(&within), without);
        }
        assert_eq!(shown(Path::new("https://user:hunter 2@host/a b?sig=hunter \"2")), "https://host/a b");
        assert!(!redacted("of https://user:hunter 2@host/a: no").contains("2@"));
        assert_eq!(redacted("http://127.0.0.1:80: refused"), "http://127.0.0.1:80: refused");
        let two = "https://a/b?hunter2,https://c/d?hunter2 https://e:hunter2@f\nhttps://user:hunter2";
        assert_eq!(redacted(two), "https://a/b https://f\nhttps://user:…");
    }

    #[cfg(unix)]
    #[test]
    fn addresses_that_are_no_text_have_no_secrets_either() {
        use std::os::unix::ffi::OsStrExt;
        let path = std::ffi::OsStr::from_bytes(b"https://user:hunter2\xff@host/a?sig=\xffhunter2");
        assert_eq!(shown(Path::new(path)), "https://host/a");
    }
}
