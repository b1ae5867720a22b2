//! Credentials, region and endpoint of a profile, as the tools of AWS keep them in `~/.aws`.
//!
//! Fixed keys and `credential_process` are read as they are. Profiles that log in or take roles
//! (`sso_session`, `role_arn`) are asked for by `aws configure export-credentials`, if the command
//! `aws` is there.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::{fs, io};

use object_store::aws::AwsCredential;

use super::connect::set;
use super::credential_process::Process;

/// What a profile says.
#[derive(Debug)]
pub(super) struct Profile {
    pub(super) credentials: Option<Credentials>,
    pub(super) region: Option<String>,
    pub(super) endpoint: Option<String>,
}

/// Where credentials come from.
#[derive(Debug)]
pub(super) enum Credentials {
    /// From the file itself.
    Fixed(AwsCredential),
    /// From a command.
    Process(Process),
}

/// The profile that is to be used; `None` if the environment has credentials of its own, or there
/// is no profile.
pub(super) fn find() -> io::Result<Option<Profile>> {
    let home = set("HOME").or_else(|| set("USERPROFILE")).map(PathBuf::from).unwrap_or_default();
    let file = |name: &str, default: &str| {
        let path = set(name).map_or_else(|| home.join(".aws").join(default), PathBuf::from);
        fs::read_to_string(path).unwrap_or_default()
    };
    let named = set("AWS_PROFILE").or_else(|| set("AWS_DEFAULT_PROFILE"));
    let (credentials, config) =
        (file("AWS_SHARED_CREDENTIALS_FILE", "credentials"), file("AWS_CONFIG_FILE", "config"));
    let own = [
        "AWS_ACCESS_KEY_ID",
        "AWS_WEB_IDENTITY_TOKEN_FILE",
        "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
        "AWS_CONTAINER_CREDENTIALS_FULL_URI",
    ];
    let has_own = own.iter().any(|name| set(name).is_some());
    let profile = read(&credentials, &config, named.as_deref().unwrap_or("default"));
    match (profile, named) {
        (None, Some(name)) if !has_own => {
            let what = format!(
                "AWS_PROFILE names `{name}`, which is in no file of ~/.aws; `aws configure list-profiles` lists them"
            );
            Err(io::Error::new(io::ErrorKind::NotFound, what))
        }
        (Some(profile), _) if has_own => Ok(Some(Profile { credentials: None, ..profile })),
        (profile, _) => Ok(profile),
    }
}

fn read(credentials: &str, config: &str, name: &str) -> Option<Profile> {
    let mut known = section(config, &[&format!("profile {name}"), name][usize::from(name == "default")..]);
    if let Some(secret) = section(credentials, &[name]) {
        known.get_or_insert_default().extend(secret);
    }
    let known = known?;
    let get = |key: &str| known.get(key).filter(|value| !value.is_empty()).cloned();
    let fixed = get("aws_access_key_id").zip(get("aws_secret_access_key"));
    let credentials = match (fixed, get("credential_process")) {
        (Some((key_id, secret_key)), _) => {
            Some(Credentials::Fixed(AwsCredential { key_id, secret_key, token: get("aws_session_token") }))
        }
        (None, Some(command)) => Some(Credentials::Process(Process::new(command))),
        _ if ["sso_session", "sso_start_url", "role_arn", "login_session"]
            .iter()
            .any(|key| known.contains_key(*key)) =>
        {
            let quoted = name.replace('\'', "'\\''");
            let command = format!("aws configure export-credentials --profile '{quoted}' --format process");
            Some(Credentials::Process(Process::new(command)))
        }
        _ => None,
    };
    Some(Profile { credentials, region: get("region"), endpoint: get("endpoint_url") })
}

/// The values of the sections with one of some names; `None` if there is none.
fn section(text: &str, names: &[&str]) -> Option<BTreeMap<String, String>> {
    let (mut found, mut inside) = (None, false);
    for line in text.lines() {
        if let Some(title) = line.trim().strip_prefix('[').and_then(|rest| rest.split(']').next()) {
            let title = title.split_whitespace().collect::<Vec<_>>().join(" ");
            inside = names.contains(&title.as_str());
            if inside {
                found.get_or_insert_with(BTreeMap::new);
            }
            continue;
        }
        // Indented lines belong to a value of several lines, of which none is used here.
        let is_comment = line.trim_start().starts_with(['#', ';']);
        if inside
            && !is_comment
            && !line.starts_with([' ', '\t'])
            && let (Some(values), Some((key, value))) = (&mut found, line.split_once('='))
        {
            values.insert(key.trim().to_ascii_lowercase(), value.trim().to_owned());
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: &str = "[default]\nregion = eu-central-1\n\n[profile  work]\nregion=us-west-2\nendpoint_url = http://host:1\n\
                          s3 =\n  addressing_style = path\n# region = no\n[profile away]\nsso_session = here\n[services x]\nregion = no\n";
    const SECRETS: &str =
        "[default]\naws_access_key_id = A\naws_secret_access_key = B=\n[work]\ncredential_process = say it\n";

    #[test]
    fn profiles_are_read_as_the_tools_of_aws_read_them() {
        let default = read(SECRETS, CONFIG, "default").expect("a profile");
        assert_eq!(default.region.as_deref(), Some("eu-central-1"));
        let Some(Credentials::Fixed(fixed)) = default.credentials else { panic!("fixed keys") };
        assert_eq!((fixed.key_id.as_str(), fixed.secret_key.as_str(), fixed.token), ("A", "B=", None));
        let work = read(SECRETS, CONFIG, "work").expect("a profile");
        assert_eq!(
            (work.region.as_deref(), work.endpoint.as_deref()),
            (Some("us-west-2"), Some("http://host:1"))
        );
        assert!(matches!(work.credentials, Some(Credentials::Process(p)) if p.command() == "say it"));
        let away = read(SECRETS, CONFIG, "away").expect("a profile");
        assert!(
            matches!(away.credentials, Some(Credentials::Process(p)) if p.command().contains("export-credentials --profile 'away'"))
        );
        assert!(read(SECRETS, CONFIG, "none").is_none() && read("", "", "default").is_none());
    }
}
