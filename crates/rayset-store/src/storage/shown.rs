//! Paths and texts as people may see them: without what an address grants access with.
//!
//! The secrets of an address are its user and password, its query and its fragment: signatures and
//! tokens stand there. All that leaves a process passes one of these functions: messages, reports,
//! names of files, what is written into outputs. What has to open an object again, such as a scene,
//! keeps the whole address.

use std::borrow::Cow;
use std::path::Path;

/// A path, or an address without its secrets.
#[must_use]
pub fn shown(path: &Path) -> String {
    let text = path.to_string_lossy();
    without_secrets(&text, Extent::Whole).unwrap_or_else(|| text.into_owned())
}

/// A text with every address in it without its secrets. Each address ends at white space, at a
/// double or backward quotation mark, or at an angle bracket.
#[must_use]
pub fn redacted(text: &str) -> Cow<'_, str> {
    without_secrets(text, Extent::Word).map_or(Cow::Borrowed(text), Cow::Owned)
}

/// Stands for what may be a user and a password.
const HIDDEN_USER: &str = "…@";

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
        // What was shown once stays as it is.
        if rest.starts_with(HIDDEN_USER) {
            out.push_str(HIDDEN_USER);
            rest = &rest[HIDDEN_USER.len()..];
        }
        match User::of(rest, extent) {
            User::None => {}
            User::Before(at) => {
                rest = &rest[at + 1..];
                changed = true;
            }
            User::Unclear { at, is_query } => {
                let (_, end) = ends(rest, extent);
                changed = true;
                if is_query {
                    out.push('…');
                    out.push_str(marks_of_a_sentence(&rest[..end]));
                    rest = &rest[end..];
                    continue;
                }
                out.push_str(HIDDEN_USER);
                rest = &rest[at + 1..];
            }
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

/// User and password of an address. A password may have letters in it that end hosts, and then an
/// address can be read in two ways: `u:1/x@host/a` has a password, or is the file `x@host/a` of the
/// host `u`. What is secret in either way is not shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum User {
    None,
    /// They stand before the `@` at this place.
    Before(usize),
    /// They may reach up to the last `@`, at this place; what is behind it may be of a query, which
    /// is secret, too.
    Unclear {
        at: usize,
        is_query: bool,
    },
}

impl User {
    /// Of the address that a text begins with.
    fn of(text: &str, extent: Extent) -> Self {
        let (authority, end) = ends(text, extent);
        // Up to the next address in it.
        let bound = text.find("://").unwrap_or(text.len());
        let last = text[..end.min(bound)].rfind('@');
        let host = &text[..authority];
        if let Some(at) = host.rfind('@') {
            return match last {
                Some(last) if last > at => Self::unclear(text, at, last),
                _ => Self::Before(at),
            };
        }
        if !is_host(host) {
            // A password with a letter that ends hosts, or words.
            let line = text.find('\n').unwrap_or(text.len());
            let Some(last) = last.or_else(|| text[..line.min(bound)].rfind('@')) else { return Self::None };
            let first = text.find('@').unwrap_or(last);
            return match Self::unclear(text, first, last) {
                Self::Unclear { is_query: false, .. } => Self::Before(last),
                unclear => unclear,
            };
        }
        match last {
            Some(at) if has_port(host) && !is_surely_host(host, &text[at..end]) => {
                Self::unclear(text, authority, at)
            }
            _ => Self::None,
        }
    }

    fn unclear(text: &str, first: usize, at: usize) -> Self {
        Self::Unclear { at, is_query: text[first..at].contains(['?', '#']) }
    }
}

/// Whether a host with a port is one, and no user with a password of digits; `behind` is what
/// follows the last `@`.
fn is_surely_host(text: &str, behind: &str) -> bool {
    let (name, port) = text.rsplit_once(':').unwrap_or((text, ""));
    let is_address = name.ends_with(']') || name.parse::<std::net::Ipv4Addr>().is_ok();
    // Objects have a path behind their host.
    let is_named = name.contains('.') && port.parse::<u16>().is_ok() && !behind.contains('/');
    name == "localhost" || is_address || is_named
}

fn has_port(text: &str) -> bool {
    text.rsplit_once(']').map_or(text, |(_, port)| port).contains(':')
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
    /// The first address of a text. One slash does for a web server: paths that are tidied have
    /// one.
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
            // Passwords that begin with digits look like ports.
            ("http://hunter2:1/hunter2@host/a.rset", "http://…@host/a.rset"),
            ("http://hunter2:12345@hunter2/hunter2@host/a", "http://…@host/a"),
            ("http://hunter2:1?hunter2@host/a", "http://…"),
            ("http://hunter2:1#hunter2@host/a", "http://…"),
            ("http://hunter2:1/hunter2@host", "http://…@host"),
            ("http://me@hunter2.org:1/hunter2@host/a?sig=hunter2", "http://…@host/a"),
            ("s3://hunter2:99/hunter2@bucket/a", "s3://…@bucket/a"),
            // An @ of a signature, behind one of a password.
            ("https://user:hunter2@host/a?sig=hunter2@hunter2", "https://…"),
            ("https://user:hun/ter2@host/a?sig=hunter2@hunter2", "https://…"),
            // Of paths and queries, without a password.
            ("https://host/a@b.rset", "https://host/a@b.rset"),
            ("https://host/a@b/c@d.rset?sig=hunter2@hunter2", "https://host/a@b/c@d.rset"),
            ("http://localhost:8080/a@2/b.rset", "http://localhost:8080/a@2/b.rset"),
            ("http://127.0.0.1:80/a@b/c?hunter2@x", "http://127.0.0.1:80/a@b/c"),
            ("http://[::1]:80/a@b/c", "http://[::1]:80/a@b/c"),
            ("https://host.org:81/a@b.rset?sig=hunter2", "https://host.org:81/a@b.rset"),
            ("s3://bucket/a@b.rset", "s3://bucket/a@b.rset"),
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
            assert_eq!(redacted(expected), expected, "it is shown once more");
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
