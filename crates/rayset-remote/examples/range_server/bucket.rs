//! As much of S3's protocol as an upload takes: objects at once or in parts, and removals (many at
//! a time, as `object_store` asks for them).

use std::collections::{BTreeMap, HashMap};

use axum::body::Body;
use axum::http::{Method, Response};
use bytes::Bytes;

use super::{Objects, status};

/// Uploads in parts that are under way.
#[derive(Default)]
pub(super) struct Uploads {
    last: u64,
    parts: HashMap<String, BTreeMap<u64, Bytes>>,
}

impl Uploads {
    pub(super) fn under_way(&self) -> usize {
        self.parts.len()
    }
}

/// Answers a request that is no read.
pub(super) fn write(
    objects: &Objects,
    name: &str,
    query: &str,
    method: &Method,
    sent: Bytes,
) -> Response<Body> {
    let value = |wanted: &str| {
        let fields = query.split('&').map(|field| field.split_once('=').unwrap_or((field, "")));
        fields.into_iter().find(|(key, _)| *key == wanted).map(|(_, value)| value.to_owned())
    };
    let xml = |text: String| Response::builder().body(Body::from(text)).expect("an answer");
    let done = || Response::builder().status(204).body(Body::empty()).expect("an answer");
    let tagged = || Response::builder().header("etag", "\"1\"").body(Body::empty()).expect("an answer");
    let mut uploads = objects.uploads.lock().expect("no panic");
    match (method.as_str(), value("uploadId")) {
        ("POST", None) if value("uploads").is_some() => {
            uploads.last += 1;
            let id = uploads.last.to_string();
            uploads.parts.insert(id.clone(), BTreeMap::new());
            xml(format!(
                "<InitiateMultipartUploadResult><Bucket>b</Bucket><Key>{name}</Key><UploadId>{id}</UploadId>\
                 </InitiateMultipartUploadResult>"
            ))
        }
        ("POST", None) if value("delete").is_some() => {
            let text = String::from_utf8_lossy(&sent);
            let keys = text.split("<Key>").skip(1).filter_map(|rest| rest.split("</Key>").next());
            let mut held = objects.objects.lock().expect("no panic");
            let removed = keys.map(|key| {
                held.remove(&format!("{name}/{key}"));
                format!("<Deleted><Key>{key}</Key></Deleted>")
            });
            xml(format!("<DeleteResult>{}</DeleteResult>", removed.collect::<String>()))
        }
        ("PUT", Some(id)) => {
            let number = value("partNumber").and_then(|number| number.parse().ok());
            let (Some(number), Some(parts)) = (number, uploads.parts.get_mut(&id)) else {
                return status(404);
            };
            parts.insert(number, sent);
            tagged()
        }
        ("POST", Some(id)) => {
            let Some(parts) = uploads.parts.remove(&id) else { return status(404) };
            objects.put(name, parts.into_values().collect::<Vec<_>>().concat());
            xml("<CompleteMultipartUploadResult><Location>x</Location><Bucket>b</Bucket><Key>k</Key><ETag>\"1\"</ETag>\
                 </CompleteMultipartUploadResult>"
                .to_owned())
        }
        ("DELETE", Some(id)) => uploads.parts.remove(&id).map_or_else(|| status(404), |_| done()),
        ("PUT", None) => {
            objects.put(name, sent.to_vec());
            tagged()
        }
        _ => status(405),
    }
}
