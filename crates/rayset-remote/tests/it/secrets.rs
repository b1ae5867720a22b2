//! Passwords, signatures and tokens: nobody else's server hears of them, and no message shows them.

use std::path::Path;

use rayset::storage;

use crate::child::Child;
use crate::common::{cloud, near, open, render, server};
use crate::range_server::{Behaviour, RangeServer};

/// What nobody else may see.
const SECRET: &str = "hunter2";

fn heard(server: &RangeServer) -> Vec<String> {
    std::mem::take(&mut *server.objects.heard.lock().expect("no panic"))
}

/// A server that says of all that begins with `moved/` that it is elsewhere.
fn moving(to: &str) -> RangeServer {
    let server = server();
    let redirects = Some(("moved/".to_owned(), to.to_owned()));
    server.behave(Behaviour { redirects, ..Behaviour::default() });
    server
}

#[test]
fn a_redirect_takes_no_secret_to_another_server() {
    let file = cloud("sphere-10k");
    let other = server();
    other.put("a.rset", file.clone());
    let first = moving(&other.address_of(""));
    let address = format!("http://user:{SECRET}@{}/moved/a.rset?sig={SECRET}", first.address);
    let opened = open(&address).expect("a cloud");
    assert!(render(&opened, 1 << 30).expect("a picture") == near(&file), "another picture");
    let (asked, seen) = (heard(&first), heard(&other));
    // `user:hunter2`, as headers have it.
    assert!(asked.iter().all(|text| text.contains("Basic dXNlcjpodW50ZXIy") && text.contains("sig=")));
    assert!(!seen.is_empty() && seen.iter().all(|text| text.contains("range")), "{seen:?}");
    for text in seen {
        let lower = text.to_lowercase();
        let tells = [SECRET, "referer", "authorization", "dxnlcjpodw50zxiy"];
        assert!(tells.iter().all(|word| !lower.contains(word)), "{text}");
    }
}

#[test]
fn a_redirect_takes_no_key_of_a_bucket_to_another_server() {
    let other = server();
    other.put("a.rset", cloud("sphere-10k"));
    let first = server();
    let redirects = Some(("bucket/".to_owned(), other.address_of("")));
    first.behave(Behaviour { redirects, ..Behaviour::default() });
    Child::new(&["read", "s3://bucket/a.rset"]).with_s3(&first, SECRET).run().expect("its bytes");
    let seen = heard(&other);
    assert!(!seen.is_empty());
    for text in seen {
        let lower = text.to_lowercase();
        let tells = [SECRET, "referer", "authorization", "x-amz-"];
        assert!(tells.iter().all(|word| !lower.contains(word)), "{text}");
    }
    // What is written is sent to the bucket's own server, or to none.
    let folder = tempfile::tempdir().expect("a folder");
    let input = folder.path().join("a.xyz");
    std::fs::write(&input, "0 0 0\n1 1 1\n").expect("a write");
    let words = ["points", &input.display().to_string(), "s3://bucket/out.rset"];
    let said =
        Child::new(&words).with_s3(&first, SECRET).within(2000, 6000).run().expect_err("it is elsewhere");
    assert!(said.contains("a redirect to another server") && !said.contains(SECRET), "{said}");
    assert!(heard(&other).iter().all(|text| text.starts_with("GET")), "something was sent");
}

#[test]
fn a_redirect_within_a_server_keeps_what_the_server_asks_for() {
    let file = cloud("sphere-10k");
    let here = server();
    here.put("a.rset", file.clone());
    let redirects = Some(("moved/".to_owned(), "/".to_owned()));
    here.behave(Behaviour { redirects, ..Behaviour::default() });
    let opened = open(&format!("http://user:{SECRET}@{}/moved/a.rset", here.address)).expect("a cloud");
    assert!(render(&opened, 1 << 30).expect("a picture") == near(&file), "another picture");
    let seen = heard(&here);
    assert!(seen.iter().any(|text| text.contains(" a.rset ")), "{seen:?}");
    for text in seen {
        assert!(text.contains("Basic dXNlcjpodW50ZXIy") && !text.contains("referer"), "{text}");
    }
}

#[test]
fn redirects_without_end_are_an_error() {
    let here = moving("/moved/");
    let said = open(&here.address_of("moved/a.rset")).expect_err("it is nowhere");
    assert!(said.contains("redirects"), "{said}");
}

/// An address with a secret wherever one may be.
fn secret_address(scheme: &str, host: &str, name: &str) -> String {
    format!("{scheme}://user:{SECRET}@{host}/{name}?X-Amz-Signature={SECRET}&sig={SECRET}#{SECRET}")
}

#[test]
fn no_error_shows_the_secrets_of_an_address() {
    let here = server();
    here.put("damaged.rset", b"rayset".to_vec());
    here.put("damaged.laz", vec![7; 1000]);
    let host = here.address.to_string();
    let refused =
        |code, says: &str| Behaviour { refuses: Some(code), says: says.into(), ..Behaviour::default() };
    // Servers that repeat what they were asked for, or signed.
    let echo = format!("Cannot GET /a?sig={SECRET} https://user:{SECRET}@host/a?sig={SECRET}");
    let xml = format!(
        "<?xml version=\"1.0\"?><Error><Code>SignatureDoesNotMatch</Code><Message>They differ.</Message>\
         <AWSAccessKeyId>{SECRET}</AWSAccessKeyId><StringToSign>GET {SECRET}</StringToSign></Error>"
    );
    // Tried several times, so asked for once.
    let mut said = vec![open(&secret_address("http", "127.0.0.1:1", "nobody")).expect_err("nobody listens")];
    for behaviour in [Behaviour::default(), refused(403, &xml), refused(400, &echo), refused(404, &echo)] {
        here.behave(behaviour);
        for address in [
            secret_address("http", &host, "damaged.rset"),
            secret_address("HTTP", &host, "none.rset"),
            secret_address("http", &host, ""),
            format!("http:/user:{SECRET}@{host}/a.rset?sig={SECRET}"),
            format!("http://user:{SECRET}/{SECRET}@{host}/a.rset"),
            format!("http://user:{SECRET} {SECRET}@/a b.rset?sig=\"{SECRET}"),
            format!("ftp://user:{SECRET}@{host}/a?sig={SECRET}"),
            format!("az://box/?sig={SECRET}"),
        ] {
            let path = Path::new(&address);
            said.push(open(&address).expect_err("it is no cloud"));
            said.push(storage::open(path, false).map_or_else(|e| e.to_string(), |_| String::new()));
            said.push(crate::common::built(path).expect_err("there are no points"));
            said.push(crate::common::built(&path.join("a.laz")).expect_err("there are no points"));
            said.push(crate::common::built_grid(path).expect_err("there are no voxels"));
            said.push(rayset::scene_file::SceneFile::load(path).expect_err("it is no scene").to_string());
            said.push(rayset::parts::Part::open(path).expect_err("it is no part").to_string());
            said.push(rayset::Grid::open(path).expect_err("it is no grid").to_string());
            said.push(
                rayset::output::Destination::new(path).map_or_else(|e| e.to_string(), |_| String::new()),
            );
            let text = format!(r#"{{"rayset":1,"root":{{"type":"cloud","file":{address:?}}}}}"#);
            let scene = rayset::scene_file::SceneFile::parse(Path::new("scene.json"), &text);
            said.push(scene.expect_err("it is no cloud").to_string());
        }
    }
    for text in said {
        assert!(!text.contains(SECRET), "{text}");
    }
}
