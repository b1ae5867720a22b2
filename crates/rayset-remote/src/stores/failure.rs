//! What went wrong, in words, and whether it may pass.

use std::borrow::Cow;
use std::io;
use std::path::Path;
use std::time::Duration;

use object_store::Error;
use rayset::storage::{RangeError, redacted, shown};

use super::redirect::NotFollowed;

/// Whether another attempt may succeed.
pub(super) fn may_pass(error: &Error) -> bool {
    match error {
        Error::Generic { .. } => match status(error) {
            Some(code) => (code >= 500 && code != 501) || matches!(code, 408 | 425 | 429),
            // A connection that was cut or not made; an answer that was not what was asked for, as
            // of a proxy.
            None => !is_expired(error) && !causes(error).any(|cause| cause.is::<NotFollowed>()),
        },
        Error::JoinError { .. } => true,
        _ => false,
    }
}

/// Whether the server has refused to answer so many requests, and would answer fewer.
pub(super) fn is_refusal(error: &Error) -> bool {
    matches!(error, Error::Generic { .. }) && matches!(status(error), Some(429 | 503))
}

/// The error of a read.
pub(super) fn of_range(error: &Error, name: &str) -> RangeError {
    let (passes, refused) = (may_pass(error), is_refusal(error));
    let error = in_words(error, name);
    match (refused, passes) {
        (true, _) => RangeError::refused(error),
        (_, true) => RangeError::passing(error),
        (_, false) => RangeError::lasting(error),
    }
}

/// The error as it is said to the user: of which object, what, and what to do.
pub(super) fn in_words(error: &Error, name: &str) -> io::Error {
    let text = without_secrets(&error.to_string());
    let (kind, what) = match error {
        Error::NotFound { .. } => {
            (io::ErrorKind::NotFound, "there is no such object, or it may not be seen".to_owned())
        }
        Error::Precondition { .. } => replaced(),
        _ if is_expired(error) => {
            let what = match name.split_once("://") {
                Some(("http" | "https", _)) => "the address has expired: get a new one, and run this again",
                Some(("az" | "azure", _)) => {
                    "the credentials have expired: renew them, as by `az login`, and run this again"
                }
                _ => "the credentials have expired: renew them, as by `aws sso login`, and run this again",
            };
            (io::ErrorKind::PermissionDenied, what.to_owned())
        }
        Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => {
            let what = format!(
                "access is denied: no or other credentials are needed (docs/remote.md says where they are looked for; for \
                 public buckets set AWS_SKIP_SIGNATURE=true or GOOGLE_SKIP_SIGNATURE=true) ({text})"
            );
            (io::ErrorKind::PermissionDenied, what)
        }
        _ if text.contains("non-partial response") || text.contains("Range request not supported") => {
            let what = "the server sends whole files only, and no ranges of them (HTTP 206 was expected): copy the file to a \
                        disk, or to a server that knows ranges";
            (io::ErrorKind::Unsupported, what.to_owned())
        }
        Error::NotSupported { .. } => (io::ErrorKind::Unsupported, text),
        Error::Generic { source, .. } if source.is::<NoAnswer>() => {
            (io::ErrorKind::TimedOut, source.to_string())
        }
        _ => match status(error) {
            Some(416) => replaced(),
            _ => (io::ErrorKind::Other, text),
        },
    };
    said(name, kind, &what)
}

/// An error about an object.
fn said(name: &str, kind: io::ErrorKind, what: &str) -> io::Error {
    io::Error::new(kind, format!("{}: {what}", shown(Path::new(name))))
}

/// The error for an object that is not the one that was opened.
pub(super) fn has_changed(name: &str) -> RangeError {
    let (kind, what) = replaced();
    RangeError::lasting(said(name, kind, &what))
}

fn replaced() -> (io::ErrorKind, String) {
    let what = "another object has taken its place since it was opened; run this again";
    (io::ErrorKind::InvalidData, what.to_owned())
}

/// Whether credentials, or an address that was signed, were valid once and are no longer.
pub(super) fn is_expired(error: &Error) -> bool {
    let text = error.to_string();
    [
        "ExpiredToken",
        "RequestExpired",
        "Request has expired",
        "TokenRefreshRequired",
        "token has expired",
        "ExpiredAuthenticationToken",
        "Signature not valid in the specified time frame",
    ]
    .iter()
    .any(|word| text.contains(word))
}

/// The error for a request that was waited for so long, in vain.
pub(super) fn no_answer(patience: Duration) -> Error {
    Error::Generic { store: "remote", source: Box::new(NoAnswer(patience)) }
}

#[derive(Debug)]
struct NoAnswer(Duration);

impl std::fmt::Display for NoAnswer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "no answer within {:.0} s", self.0.as_secs_f64().ceil())
    }
}

impl std::error::Error for NoAnswer {}

/// Whether no answer came at all: it was not waited for any longer, or there was no connection.
pub(super) fn is_without_answer(error: &Error) -> bool {
    causes(error).any(|cause| cause.is::<NoAnswer>() || cause.is::<object_store::client::HttpError>())
}

/// What an error was caused by, and what that was caused by.
fn causes(error: &Error) -> impl Iterator<Item = &(dyn std::error::Error + 'static)> {
    std::iter::successors(std::error::Error::source(error), |cause| cause.source())
}

/// The status of HTTP that an error is about. `object_store` tells it only in words.
fn status(error: &Error) -> Option<u16> {
    let text = error.to_string();
    let (_, rest) = text.split_once("status code: ")?;
    rest.get(..3)?.parse().ok()
}

/// A message of a server without what grants access, and of bearable length.
fn without_secrets(text: &str) -> String {
    let text = redacted(text);
    let text = without_elements(&text);
    let words: Vec<&str> = text.split_whitespace().map(without_query).collect();
    let text = words.join(" ").replace(char::is_control, " ");
    match text.char_indices().nth(600) {
        Some((end, _)) => format!("{} …", &text[..end]),
        None => text,
    }
}

/// A word without the query that begins in it: some servers say what they were asked for.
fn without_query(word: &str) -> &str {
    match word.split_once('?') {
        Some((before, query)) if query.contains('=') => before,
        _ => word,
    }
}

/// A text without the XML or HTML in it, but for what says what went wrong. Others of its elements
/// repeat signatures, tokens and what was signed.
fn without_elements(text: &str) -> Cow<'_, str> {
    let begins =
        |at: &usize| text[at + 1..].starts_with(|c: char| c.is_ascii_alphabetic() || "?!/".contains(c));
    let Some(at) = text.match_indices('<').map(|(at, _)| at).find(begins) else {
        return Cow::Borrowed(text);
    };
    let (before, body) = text.split_at(at);
    let said = ["Code", "Message", "title"].iter().filter_map(|name| {
        let (_, rest) = body.split_once(&format!("{name}>"))?;
        rest.split('<').next().map(str::trim).filter(|said| !said.is_empty())
    });
    Cow::Owned(format!("{before}{}", said.collect::<Vec<_>>().join(": ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn generic(text: &str) -> Error {
        Error::Generic { store: "S3", source: text.to_owned().into() }
    }

    #[test]
    fn overload_passes_and_what_is_wrong_lasts() {
        for (text, passes, refused) in [
            ("Server returned non-2xx status code: 503 Slow Down: ", true, true),
            ("Server returned non-2xx status code: 429 Too Many: ", true, true),
            ("Server returned non-2xx status code: 500 Internal Server Error: ", true, false),
            ("error sending request", true, false),
            ("Server returned non-2xx status code: 400 Bad Request: <Code>ExpiredToken</Code>", false, false),
            ("Server returned non-2xx status code: 416 Range Not Satisfiable: ", false, false),
        ] {
            let error = generic(text);
            assert_eq!((may_pass(&error), is_refusal(&error)), (passes, refused), "{text}");
        }
    }

    #[test]
    fn messages_name_the_object_and_keep_secrets() {
        let error = generic("Error performing GET https://host/a?X-Amz-Signature=secret in 1s - cut");
        let said = in_words(&error, "https://host/a").to_string();
        assert_eq!(said, "https://host/a: Generic S3 error: Error performing GET https://host/a in 1s - cut");
        let error = generic(
            "status code: 403 Forbidden: <?xml?><Error><Code>SignatureDoesNotMatch</Code><Message>No match.</Message>\
             <SignatureProvided>secret</SignatureProvided><StringToSign>GET secret</StringToSign></Error>",
        );
        let said = in_words(&error, "s3://b/a?sig=secret").to_string();
        assert!(said.starts_with("s3://b/a: ") && !said.contains("secret"), "{said}");
        assert!(said.ends_with("403 Forbidden: SignatureDoesNotMatch: No match."), "{said}");
        let error = generic("status code: 400 Bad Request: Cannot GET /a?X-Amz-Signature=secret");
        assert!(!in_words(&error, "https://host/a").to_string().contains("secret"));
        let error = generic("status code: 400 Bad Request: <Code>ExpiredToken</Code>");
        assert!(in_words(&error, "s3://b/a").to_string().contains("credentials have expired"));
    }
}
