//! Uploads that are pending in a bucket of S3: those of an object whose identities nobody knows any
//! more, because a run was killed, or an answer lost, between the beginning of an upload and the
//! note that says so.

use std::sync::Arc;
use std::time::Duration;

use object_store::client::{ClientOptions, HttpClient, HttpConnector, HttpRequest, HttpRequestBody};
use object_store::path::Path;
use object_store::signer::{SignedUrlOptions, Signer};
use object_store::{Error, Result};
use quick_xml::Reader;
use quick_xml::escape::resolve_predefined_entity;
use quick_xml::events::Event;

use super::redirect::Connector;

/// How long the signature of a request is good for.
const GOOD_FOR: Duration = Duration::from_secs(300);

/// Asks a bucket for its pending uploads.
#[derive(Clone)]
pub(super) struct Pending {
    signer: Arc<dyn Signer>,
    client: HttpClient,
}

impl Pending {
    pub(super) fn new(signer: Arc<dyn Signer>, options: &ClientOptions) -> Result<Self> {
        Ok(Self { signer, client: Connector.connect(options)? })
    }

    /// The uploads of exactly this object, of the first thousand of objects whose names begin as
    /// its does: those of the shortest name come first.
    pub(super) async fn of(&self, path: &Path) -> Result<Vec<String>> {
        let mut request = HttpRequest::new(HttpRequestBody::empty());
        let query = [("uploads", ""), ("prefix", path.as_ref())];
        let options = SignedUrlOptions::default().with_query(query);
        let method = request.method().clone();
        let url = self.signer.signed_url_opts(method, &Path::default(), GOOD_FOR, &options).await?;
        *request.uri_mut() = url.as_str().parse().map_err(failed)?;
        let answer = self.client.execute(request).await.map_err(failed)?;
        let status = answer.status();
        let text = answer.into_body().bytes().await.map_err(failed)?;
        if !status.is_success() {
            return Err(failed(format!("{status} for the list of pending uploads")));
        }
        uploads(&String::from_utf8_lossy(&text), path.as_ref()).map_err(failed)
    }
}

fn failed(source: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Error {
    Error::Generic { store: "S3", source: source.into() }
}

/// The identities of the uploads of a key, in the answer of a service.
fn uploads(text: &str, key: &str) -> Result<Vec<String>, quick_xml::Error> {
    let mut reader = Reader::from_str(text);
    let (mut found, mut upload, mut within) = (Vec::new(), Upload::default(), String::new());
    loop {
        match reader.read_event()? {
            Event::Start(start) => {
                within.clear();
                within.push_str(start.local_name().as_ref());
                if within == "Upload" {
                    upload = Upload::default();
                }
            }
            Event::Text(part) => upload.read(&within, &part.into_inner()),
            Event::GeneralRef(reference) => match reference.resolve_char_ref()? {
                Some(letter) => upload.read(&within, letter.encode_utf8(&mut [0; 4])),
                None => upload
                    .read(&within, resolve_predefined_entity(&reference.into_inner()).unwrap_or_default()),
            },
            Event::End(end) => {
                within.clear();
                if end.local_name().as_ref() == "Upload" && upload.key == key && !upload.id.is_empty() {
                    found.push(std::mem::take(&mut upload.id));
                }
            }
            Event::Eof => return Ok(found),
            _ => {}
        }
    }
}

/// What matters of an upload, as far as it has been read.
#[derive(Default)]
struct Upload {
    key: String,
    id: String,
}

impl Upload {
    /// Reads on in the text of an element.
    fn read(&mut self, element: &str, text: &str) {
        match element {
            "Key" => self.key.push_str(text),
            "UploadId" => self.id.push_str(text),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uploads_of_exactly_one_object_are_found_in_the_answer() {
        let upload = |key: &str, id: &str| {
            format!(
                "<Upload><Key>{key}</Key><UploadId>{id}</UploadId><Initiator><ID>other</ID></Initiator></Upload>"
            )
        };
        let text = format!(
            "<?xml version=\"1.0\"?><ListMultipartUploadsResult xmlns=\"http://s3.amazonaws.com/doc/2006-03-01/\">\
             <Bucket>b</Bucket><KeyMarker/><Prefix>a&amp;b.rset</Prefix>{}{}{}{}</ListMultipartUploadsResult>",
            upload("a&amp;b.rset", "one_1.~-"),
            upload("a&#38;b.rset", "two"),
            upload("a&amp;b.rset.other", "three"),
            upload("a&amp;b.rset", "")
        );
        assert_eq!(uploads(&text, "a&b.rset").expect("XML"), ["one_1.~-", "two"]);
        assert!(uploads("<a/>", "a").expect("XML").is_empty());
        assert!(uploads("<Upload><Key>a</", "a").is_err());
    }
}
