//! Clients of Azure's containers, with what its own tools are told: variables of the environment
//! and connection strings.

use object_store::azure::{AzureConfigKey, MicrosoftAzureBuilder};
use object_store::{ClientOptions, azure::MicrosoftAzure};
use url::Url;

use super::connect::{once, set};
use super::redirect::Connector;

/// The client of a container. `options` are those of connections, if they may be insecure or not.
pub(super) fn client(
    container: &str,
    options: impl Fn(bool) -> ClientOptions,
) -> object_store::Result<MicrosoftAzure> {
    let mut builder = MicrosoftAzureBuilder::from_env().with_container_name(container).with_retry(once());
    let mut has_key =
        ["AZURE_STORAGE_ACCOUNT_KEY", "AZURE_STORAGE_SAS_TOKEN", "AZURE_STORAGE_SAS_KEY", "AZURE_CLIENT_ID"]
            .iter()
            .any(|name| set(name).is_some());
    if let Some(account) = set("AZURE_STORAGE_ACCOUNT") {
        builder = builder.with_account(account);
    }
    if let Some(key) = set("AZURE_STORAGE_KEY") {
        (builder, has_key) = (builder.with_access_key(key), true);
    }
    let said = Connection::read(&set("AZURE_STORAGE_CONNECTION_STRING").unwrap_or_default());
    if said.is_emulator {
        (builder, has_key) = (builder.with_use_emulator(true), true);
    }
    if let Some(account) = said.account {
        builder = builder.with_account(account);
    }
    if let Some(key) = said.key {
        (builder, has_key) = (builder.with_access_key(key), true);
    }
    if let Some(signature) = said.signature {
        (builder, has_key) = (builder.with_config(AzureConfigKey::SasKey, signature), true);
    }
    let endpoint = said.endpoint.or_else(|| set("AZURE_STORAGE_ENDPOINT")).or_else(|| set("AZURE_ENDPOINT"));
    let insecure = endpoint.as_deref().is_some_and(|endpoint| endpoint.starts_with("http:"));
    if let Some(endpoint) = endpoint {
        builder = builder.with_endpoint(endpoint);
    }
    // As whoever has said `az login`.
    if !has_key && set("AZURE_SKIP_SIGNATURE").is_none() {
        builder = builder.with_use_azure_cli(true);
    }
    builder.with_client_options(options(insecure)).with_http_connector(Connector).build()
}

/// What a connection string says.
#[derive(Debug, Default, PartialEq, Eq)]
struct Connection {
    account: Option<String>,
    key: Option<String>,
    /// A shared access signature.
    signature: Option<String>,
    endpoint: Option<String>,
    /// The emulator on this machine is meant.
    is_emulator: bool,
}

impl Connection {
    /// Reads `KEY=VALUE;…`. What it does not know it leaves out, as the tools of Azure do.
    fn read(text: &str) -> Self {
        let mut said = Self::default();
        let (mut protocol, mut suffix) = (None, None);
        for (key, value) in text.split(';').filter_map(|field| field.trim().split_once('=')) {
            let value = Some(value.trim().to_owned()).filter(|value| !value.is_empty());
            match key.trim().to_ascii_lowercase().as_str() {
                "accountname" => said.account = value,
                "accountkey" => said.key = value,
                "sharedaccesssignature" => {
                    said.signature = value.map(|value| value.trim_start_matches('?').to_owned());
                }
                "blobendpoint" => said.endpoint = value,
                "defaultendpointsprotocol" => protocol = value,
                "endpointsuffix" => suffix = value,
                "usedevelopmentstorage" => {
                    said.is_emulator = value.is_some_and(|value| value.eq_ignore_ascii_case("true"));
                }
                _ => {}
            }
        }
        match (&said.endpoint, &said.account) {
            (None, Some(account)) if protocol.is_some() || suffix.is_some() => {
                let protocol = protocol.unwrap_or_else(|| "https".to_owned());
                let suffix = suffix.unwrap_or_else(|| "core.windows.net".to_owned());
                said.endpoint = Some(format!("{protocol}://{account}.blob.{suffix}"));
            }
            (Some(endpoint), None) => said.account = account_of(endpoint),
            _ => {}
        }
        said
    }
}

/// The account that an endpoint is of: the first part of its host, or of its path if the host is a
/// number or this machine.
fn account_of(endpoint: &str) -> Option<String> {
    let url = Url::parse(endpoint).ok()?;
    let in_path = || url.path_segments()?.next().filter(|part| !part.is_empty()).map(str::to_owned);
    match url.host()? {
        url::Host::Domain(name) => match name.split_once('.') {
            Some((account, _)) => Some(account.to_owned()),
            None => in_path(),
        },
        _ => in_path(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> [Option<String>; 4] {
        let Connection { account, key, signature, endpoint, .. } = Connection::read(text);
        [account, key, signature, endpoint]
    }

    fn some(text: &str) -> Option<String> {
        Some(text.to_owned())
    }

    #[test]
    fn connection_strings_are_read_as_the_tools_of_azure_read_them() {
        let usual =
            "DefaultEndpointsProtocol=https;AccountName=me;AccountKey=a2V5==;EndpointSuffix=core.windows.net";
        let endpoint = some("https://me.blob.core.windows.net");
        assert_eq!(read(usual), [some("me"), some("a2V5=="), None, endpoint]);
        let china = "AccountName=me;AccountKey=k;EndpointSuffix=core.chinacloudapi.cn;";
        assert_eq!(read(china)[3], some("https://me.blob.core.chinacloudapi.cn"));
        // Without either, the endpoint is the usual one, which nothing has to be said for.
        assert_eq!(read("AccountName=me;AccountKey=k"), [some("me"), some("k"), None, None]);
    }

    #[test]
    fn connection_strings_with_a_signature_name_the_account_by_their_endpoint() {
        let signed =
            "BlobEndpoint=https://me.blob.core.windows.net/;SharedAccessSignature=?sv=2022-11-02&sig=a%3D";
        let endpoint = some("https://me.blob.core.windows.net/");
        assert_eq!(read(signed), [some("me"), None, some("sv=2022-11-02&sig=a%3D"), endpoint]);
        for (endpoint, account) in [
            ("http://127.0.0.1:10000/devstoreaccount1", Some("devstoreaccount1")),
            ("http://localhost:10000/devstoreaccount1/", Some("devstoreaccount1")),
            ("http://azurite/me", Some("me")),
            ("http://127.0.0.1:1/", None),
            ("no address", None),
        ] {
            assert_eq!(account_of(endpoint).as_deref(), account, "{endpoint}");
        }
        // One that is named comes before the one that the endpoint seems to be of.
        let named = "BlobEndpoint=https://cdn.example.org;accountname=me;SharedAccessSignature=sig=x";
        assert_eq!(read(named)[0], some("me"));
    }

    #[test]
    fn connection_strings_may_mean_the_emulator_or_nothing() {
        assert!(Connection::read("UseDevelopmentStorage=true").is_emulator);
        assert_eq!(Connection::read(""), Connection::default());
        assert_eq!(Connection::read(";;AccountName=;nonsense;x=y"), Connection::default());
    }
}
