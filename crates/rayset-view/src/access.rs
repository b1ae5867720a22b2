//! Who may look: tokens that open a page once, cookies that keep it open, and the names under which
//! the program may be reached.
//!
//! Any program and any page on a machine can connect to a port of it. A token, printed by the
//! program, proves that whoever opens the page has been told; it is used up by the first visit and
//! becomes a cookie that scripts cannot read and that no other site can send along. `Host` is
//! checked so that a name that somebody else points at this machine opens nothing (DNS rebinding),
//! `Origin` so that no other page can open the socket.

use std::collections::VecDeque;
use std::net::IpAddr;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use axum::http::{HeaderMap, header};
use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;

/// Bytes of a token, and of the key that cookies are signed with.
pub const SECRET_BYTES: usize = 32;
/// Most tokens that have been issued and not yet used; beyond that, the oldest is worth nothing.
const MOST_TOKENS: usize = 64;

/// Decides about visitors.
pub(crate) struct Access {
    /// Signs passwords.
    signer: Hmac<Sha256>,
    /// Signs cookies.
    cookie_signer: Hmac<Sha256>,
    cookie_name: String,
    allowed_hosts: Vec<String>,
    /// Issued, and not used yet.
    tokens: Mutex<VecDeque<String>>,
    /// What lets in from elsewhere.
    password: Option<Password>,
}

/// Who knows it is let in. Compared by its signature, in constant time.
struct Password {
    signature: Vec<u8>,
    /// When it was last tried.
    tried: Mutex<Option<Instant>>,
}

/// Between two attempts at the password, whoever makes them.
const BETWEEN_ATTEMPTS: Duration = Duration::from_millis(500);
/// Least characters of a password.
pub(crate) const LEAST_PASSWORD: usize = 8;

/// Why a visitor is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Refusal {
    #[error("the Host header names another machine")]
    Host,
    #[error("the Origin header is missing or names another site")]
    Origin,
    #[error("the token is unknown or has been used")]
    Token,
    #[error("there is no cookie, or it is not one of this program")]
    Cookie,
    #[error("the password is wrong, or was tried too soon after another")]
    Password,
}

/// Random bytes from the system.
pub fn secret() -> std::io::Result<[u8; SECRET_BYTES]> {
    let mut bytes = [0; SECRET_BYTES];
    getrandom::fill(&mut bytes).map_err(std::io::Error::other)?;
    Ok(bytes)
}

impl Access {
    pub(crate) fn new(
        key: [u8; SECRET_BYTES],
        port: u16,
        allowed_hosts: Vec<String>,
        password: Option<&str>,
    ) -> Self {
        let mut block = hmac::digest::Key::<Hmac<Sha256>>::default();
        block[..SECRET_BYTES].copy_from_slice(&key);
        // HMAC fills a key that is shorter than its block with zeros, as here.
        let signer = Hmac::<Sha256>::new(&block);
        let password = password.map(|password| {
            let signature = of_password(&signer, password).finalize().into_bytes().to_vec();
            Password { signature, tried: Mutex::default() }
        });
        // Cookies of one password are worth nothing with another.
        let mut cookie_signer = signer.clone();
        if let Some(password) = &password {
            cookie_signer.update(&password.signature);
        }
        let cookie_name = format!("rayset-{port}");
        Self { signer, cookie_signer, cookie_name, allowed_hosts, tokens: Mutex::default(), password }
    }

    /// Whether there is a password, and so people from elsewhere.
    pub(crate) fn has_password(&self) -> bool {
        self.password.is_some()
    }

    /// Lets in who knows the password. Returns the cookie to set.
    pub(crate) fn enter(&self, attempt: &str) -> Result<String, Refusal> {
        self.enter_at(attempt, Instant::now())
    }

    fn enter_at(&self, attempt: &str, now: Instant) -> Result<String, Refusal> {
        let password = self.password.as_ref().ok_or(Refusal::Password)?;
        {
            let mut tried = password.tried.lock().unwrap_or_else(PoisonError::into_inner);
            if tried.is_some_and(|before| now.saturating_duration_since(before) < BETWEEN_ATTEMPTS) {
                return Err(Refusal::Password);
            }
            *tried = Some(now);
        }
        let attempt = of_password(&self.signer, attempt);
        attempt.verify_slice(&password.signature).map_err(|_| Refusal::Password)?;
        self.cookie()
    }

    /// A new token, for one visit.
    pub(crate) fn issue(&self) -> std::io::Result<String> {
        let token = hex(&secret()?[..16]);
        let mut tokens = self.tokens.lock().unwrap_or_else(PoisonError::into_inner);
        if tokens.len() >= MOST_TOKENS {
            tokens.pop_front();
        }
        tokens.push_back(token.clone());
        Ok(token)
    }

    /// Uses a token up. Returns the cookie to set.
    pub(crate) fn redeem(&self, token: &str) -> Result<String, Refusal> {
        let mut tokens = self.tokens.lock().unwrap_or_else(PoisonError::into_inner);
        let known = tokens.iter().position(|issued| issued == token).ok_or(Refusal::Token)?;
        tokens.remove(known);
        drop(tokens);
        self.cookie()
    }

    /// A cookie of a new visitor.
    fn cookie(&self) -> Result<String, Refusal> {
        let visitor = hex(&secret().map_err(|_| Refusal::Token)?[..16]);
        let signature = self.signature(&visitor);
        Ok(format!("{}={visitor}.{signature}; HttpOnly; SameSite=Strict; Path=/", self.cookie_name))
    }

    /// Checks that a request was meant for this program.
    pub(crate) fn check_host(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        let host = text(headers, &header::HOST).ok_or(Refusal::Host)?;
        let name = without_port(host).to_ascii_lowercase();
        // Ports differ behind tunnels; names of this machine are what matters.
        let is_here = ["localhost", "127.0.0.1", "[::1]"].contains(&&*name);
        let is_allowed =
            |allowed: &String| allowed.eq_ignore_ascii_case(host) || allowed.eq_ignore_ascii_case(&name);
        // An address, unlike a name, cannot be made to mean another machine.
        let is_address = self.has_password() && name.trim_matches(['[', ']']).parse::<IpAddr>().is_ok();
        if is_here || is_address || self.allowed_hosts.iter().any(is_allowed) {
            Ok(())
        } else {
            Err(Refusal::Host)
        }
    }

    /// Checks that a request comes from a page of this program: its origin is the host that it was
    /// sent to.
    pub(crate) fn check_origin(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        let host = text(headers, &header::HOST).ok_or(Refusal::Origin)?;
        let origin = text(headers, &header::ORIGIN).ok_or(Refusal::Origin)?;
        let site = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
        // A proxy in front may take other names for the same place; those that it was told of count
        // as one. Without a port, it is the usual one that was allowed, not any.
        let is_allowed =
            |name: &str| self.allowed_hosts.iter().any(|allowed| allowed.eq_ignore_ascii_case(name));
        match site {
            Some(site) if site.eq_ignore_ascii_case(host) || is_allowed(site) => Ok(()),
            _ => Err(Refusal::Origin),
        }
    }

    /// Checks that a visitor has been let in before.
    pub(crate) fn check_cookie(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        let cookies = headers.get_all(header::COOKIE).into_iter().filter_map(|value| value.to_str().ok());
        let mut pairs =
            cookies.flat_map(|line| line.split(';')).filter_map(|pair| pair.trim().split_once('='));
        let is_ours = |(name, value): (&str, &str)| {
            let Some((visitor, signature)) = value.split_once('.') else { return false };
            name == self.cookie_name && self.is_signature(visitor, signature)
        };
        if pairs.any(is_ours) { Ok(()) } else { Err(Refusal::Cookie) }
    }

    fn mac(&self, visitor: &str) -> Hmac<Sha256> {
        let mut mac = self.cookie_signer.clone();
        // Cookies are sent to all ports of a machine: one of another port is none of ours.
        mac.update(self.cookie_name.as_bytes());
        mac.update(b"=");
        mac.update(visitor.as_bytes());
        mac
    }

    fn signature(&self, visitor: &str) -> String {
        hex(&self.mac(visitor).finalize().into_bytes())
    }

    /// Compares in constant time.
    fn is_signature(&self, visitor: &str, signature: &str) -> bool {
        unhex(signature).is_some_and(|bytes| self.mac(visitor).verify_slice(&bytes).is_ok())
    }
}

/// The signature of a password. No cookie has it: none has an empty name.
fn of_password(signer: &Hmac<Sha256>, password: &str) -> Hmac<Sha256> {
    let mut mac = signer.clone();
    mac.update(b"=password=");
    mac.update(password.as_bytes());
    mac
}

fn text<'h>(headers: &'h HeaderMap, name: &header::HeaderName) -> Option<&'h str> {
    let mut values = headers.get_all(name).into_iter();
    let first = values.next()?;
    // Two of them are somebody's trick.
    if values.next().is_some() { None } else { first.to_str().ok() }
}

/// The name in `name:port`; IPv6 addresses stand in brackets.
fn without_port(host: &str) -> &str {
    match host.rfind(':') {
        Some(at) if !host[at..].contains(']') => &host[..at],
        _ => host,
    }
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn unhex(text: &str) -> Option<Vec<u8>> {
    let pairs = text.as_bytes().as_chunks::<2>();
    if !pairs.1.is_empty() {
        return None;
    }
    pairs.0.iter().map(|pair| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok()).collect()
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;
    use proptest::prelude::*;

    use super::*;

    fn access(key: u8, port: u16) -> Access {
        Access::new([key; SECRET_BYTES], port, vec!["scans.example.org".into(), "proxy:8443".into()], None)
    }

    fn headers(pairs: &[(header::HeaderName, &str)]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for (name, value) in pairs {
            headers.append(name, HeaderValue::from_str(value).expect("a header"));
        }
        headers
    }

    #[test]
    fn a_token_lets_in_once_and_its_cookie_from_then_on_also_after_a_restart() {
        let here = access(1, 8000);
        let token = here.issue().expect("a token");
        let cookie = here.redeem(&token).expect("it is known");
        assert_eq!(here.redeem(&token), Err(Refusal::Token));
        assert_eq!(here.redeem(""), Err(Refusal::Token));
        assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"), "{cookie}");
        let pair = cookie.split(';').next().expect("a pair");
        let sent = headers(&[(header::COOKIE, &format!("other=1; {pair}"))]);
        assert_eq!(here.check_cookie(&sent), Ok(()));
        assert_eq!(access(1, 8000).check_cookie(&sent), Ok(()));
        assert_eq!(access(2, 8000).check_cookie(&sent), Err(Refusal::Cookie), "another key");
        assert_eq!(access(1, 8001).check_cookie(&sent), Err(Refusal::Cookie), "another port");
        let renamed = pair.replace("rayset-8000", "rayset-8001");
        assert_eq!(
            access(1, 8001).check_cookie(&headers(&[(header::COOKIE, &renamed)])),
            Err(Refusal::Cookie)
        );
        assert_eq!(here.check_cookie(&HeaderMap::new()), Err(Refusal::Cookie));
    }

    #[test]
    fn only_names_of_this_machine_and_those_that_were_allowed_are_hosts() {
        let access = access(1, 8000);
        for good in
            ["localhost:8000", "127.0.0.1:9000", "[::1]:8000", "LOCALHOST", "scans.example.org", "proxy:8443"]
        {
            assert_eq!(access.check_host(&headers(&[(header::HOST, good)])), Ok(()), "{good}");
        }
        for bad in [
            "evil.example.org:8000",
            "localhost.evil.org",
            "127.0.0.1.nip.io:8000",
            "proxy:1",
            "",
            "[::2]:8000",
        ] {
            assert_eq!(access.check_host(&headers(&[(header::HOST, bad)])), Err(Refusal::Host), "{bad}");
        }
        assert_eq!(access.check_host(&HeaderMap::new()), Err(Refusal::Host));
        let two = headers(&[(header::HOST, "localhost"), (header::HOST, "evil.org")]);
        assert_eq!(access.check_host(&two), Err(Refusal::Host));
    }

    #[test]
    fn only_the_programs_own_pages_open_the_socket() {
        let access = access(1, 8000);
        let from = |origin| headers(&[(header::HOST, "localhost:8000"), (header::ORIGIN, origin)]);
        assert_eq!(access.check_origin(&from("http://localhost:8000")), Ok(()));
        assert_eq!(access.check_origin(&from("https://scans.example.org")), Ok(()));
        for bad in [
            "http://localhost:3000",
            "http://evil.org",
            "null",
            "file://",
            "http://localhost:8000.evil.org",
            "http://scans.example.org:3000",
        ] {
            assert_eq!(access.check_origin(&from(bad)), Err(Refusal::Origin), "{bad}");
        }
        assert_eq!(access.check_origin(&headers(&[(header::HOST, "localhost:8000")])), Err(Refusal::Origin));
    }

    #[test]
    fn the_password_lets_in_and_is_not_tried_twice_at_once() {
        let here = Access::new([1; SECRET_BYTES], 8000, Vec::new(), Some("a long sentence"));
        let now = Instant::now();
        assert_eq!(here.enter_at("a long sentenc", now), Err(Refusal::Password));
        let sooner = now + BETWEEN_ATTEMPTS - Duration::from_millis(1);
        assert_eq!(here.enter_at("a long sentence", sooner), Err(Refusal::Password), "too soon");
        let cookie = here.enter_at("a long sentence", now + BETWEEN_ATTEMPTS).expect("it is right");
        let pair = cookie.split(';').next().expect("a pair");
        assert_eq!(here.check_cookie(&headers(&[(header::COOKIE, pair)])), Ok(()));
        let other = Access::new([1; SECRET_BYTES], 8000, Vec::new(), Some("another sentence"));
        assert_eq!(other.check_cookie(&headers(&[(header::COOKIE, pair)])), Err(Refusal::Cookie));
        let to = |host| headers(&[(header::HOST, host)]);
        assert_eq!(here.check_host(&to("192.168.1.20:8000")), Ok(()), "where it listens beyond this machine");
        assert_eq!(here.check_host(&to("evil.example.org:8000")), Err(Refusal::Host));
        assert_eq!(access(1, 8000).check_host(&to("192.168.1.20:8000")), Err(Refusal::Host));
        assert_eq!(access(1, 8000).enter(""), Err(Refusal::Password), "there is none");
    }

    proptest! {
        #[test]
        fn no_header_makes_the_checks_panic(value in "[ -~]{0,80}") {
            let access = access(1, 8000);
            let headers = headers(&[(header::HOST, &value), (header::ORIGIN, &value), (header::COOKIE, &value)]);
            let _ = access.check_host(&headers);
            let _ = access.check_origin(&headers);
            prop_assert_eq!(access.check_cookie(&headers), Err(Refusal::Cookie));
        }
    }
}
