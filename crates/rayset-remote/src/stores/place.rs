//! What an address says.

use std::io;

use object_store::path::Path;
use rayset::storage::shown;
use url::Url;

/// Whom to ask.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum Keeper {
    /// A bucket of S3, or of what speaks its protocol.
    S3(String),
    /// A bucket of Google's.
    Google(String),
    /// A container of Azure's.
    Azure(String),
    /// A web server: scheme, host and port, with the query of the address, which may be what grants
    /// access.
    Web(String),
}

/// An object: its keeper, and its place there.
#[derive(Clone, Debug)]
pub(super) struct ObjectAddress {
    pub(super) keeper: Keeper,
    pub(super) path: Path,
    /// Tells it from other objects of its keeper: the address, that of a web server without its
    /// secrets.
    pub(super) name: String,
}

impl ObjectAddress {
    pub(super) fn new(address: &str) -> io::Result<Self> {
        let wrong = |what: &str| {
            let what = format!(
                "{}: {what}; expected s3://BUCKET/KEY, gs://BUCKET/KEY, az://CONTAINER/BLOB or https://HOST/PATH",
                shown(std::path::Path::new(address))
            );
            io::Error::new(io::ErrorKind::InvalidInput, what)
        };
        let (scheme, rest) = address.split_once("://").ok_or_else(|| wrong("this is no address"))?;
        let scheme = scheme.to_ascii_lowercase();
        if scheme == "http" || scheme == "https" {
            return Self::web(address).ok_or_else(|| wrong("this is no address of a file on a web server"));
        }
        let (bucket, key) = rest.split_once('/').ok_or_else(|| wrong("it names no object"))?;
        if bucket.is_empty() || key.is_empty() || key.ends_with('/') {
            return Err(wrong("it names no object"));
        }
        let keeper = match scheme.as_str() {
            "s3" | "s3a" => Keeper::S3(bucket.to_owned()),
            "gs" | "gcs" => Keeper::Google(bucket.to_owned()),
            "az" | "azure" => Keeper::Azure(bucket.to_owned()),
            _ => return Err(wrong(&format!("`{scheme}` is unknown"))),
        };
        let path = Path::parse(key).map_err(|error| wrong(&error.to_string()))?;
        Ok(Self { keeper, path, name: address.to_owned() })
    }

    fn web(address: &str) -> Option<Self> {
        let url = Url::parse(address).ok()?;
        let path = Path::from_url_path(url.path()).ok().filter(|path| !path.as_ref().is_empty())?;
        let mut host = url.clone();
        host.set_path("/");
        host.set_fragment(None);
        let mut name = url;
        let _ = (name.set_password(None), name.set_username(""));
        name.set_query(None);
        name.set_fragment(None);
        // A password may have been taken for a part of the path.
        let shown = shown(std::path::Path::new(address));
        let name = if shown.contains('…') { shown } else { name.into() };
        Some(Self { keeper: Keeper::Web(host.into()), path, name })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_name_a_keeper_and_an_object() {
        let place = ObjectAddress::new("s3://bucket/a/b c?#.rset").expect("an address");
        assert_eq!((place.keeper, place.path.as_ref()), (Keeper::S3("bucket".into()), "a/b c?#.rset"));
        let place = ObjectAddress::new("https://u:p@host:81/a%20b.rset?token=x").expect("an address");
        assert_eq!(place.keeper, Keeper::Web("https://u:p@host:81/?token=x".into()));
        assert_eq!(place.name, "https://host:81/a%20b.rset");
        for unclear in ["http://u:12345@hunter2/hunter2@host/a", "http://u:1/hunter2@host/a"] {
            assert_eq!(ObjectAddress::new(unclear).expect("an address").name, "http://…@host/a");
        }
        for wrong in
            ["s3://bucket", "s3://bucket/", "s3://bucket/a/", "s3:///a", "ftp://host/a", "https://host/"]
        {
            let said = ObjectAddress::new(wrong).expect_err("no object").to_string();
            assert!(said.contains("expected s3://BUCKET/KEY"), "{said}");
        }
    }
}
