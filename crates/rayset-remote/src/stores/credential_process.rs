//! Credentials that a command says: asked for when they are needed first, again before they expire,
//! and again when a server says that they have.

use std::io;
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use async_trait::async_trait;
use object_store::CredentialProvider;
use object_store::aws::AwsCredential;
use tokio::sync::Mutex;

/// How long credentials that say no end are used before they are asked for again.
const USED_FOR: Duration = Duration::from_secs(600);
/// Those that say one are asked for again so long before it; sooner after half of their time, if it
/// is short.
const RENEWED_BEFORE: Duration = Duration::from_secs(300);
/// How long a command may take.
const ANSWERS_WITHIN: Duration = Duration::from_secs(25);

/// A command that says credentials, and what it said last.
#[derive(Debug)]
pub(super) struct Process {
    command: String,
    /// Locked while the command runs, so that one is run for all who wait.
    said: Mutex<Option<CachedCredential>>,
    /// How often other credentials have been said than before.
    turns: AtomicU64,
}

#[derive(Clone, Debug)]
struct CachedCredential {
    credential: Arc<AwsCredential>,
    /// When it is to be asked for again.
    until: SystemTime,
}

impl Process {
    pub(super) fn new(command: String) -> Self {
        Self { command, said: Mutex::default(), turns: AtomicU64::new(0) }
    }

    #[cfg(test)]
    pub(super) fn command(&self) -> &str {
        &self.command
    }

    /// What is run, for messages: its arguments may be secrets.
    fn program(&self) -> &str {
        let mut words = self.command.split_whitespace();
        // Variables that are set for it come first.
        words.find(|word| !word.contains('=')).unwrap_or_default()
    }

    /// A number for the credentials that a request made now is made with, which is another for
    /// others.
    pub(super) async fn turn_now(&self) -> object_store::Result<u64> {
        self.get_credential().await?;
        Ok(self.turn())
    }

    fn turn(&self) -> u64 {
        self.turns.load(Ordering::Relaxed)
    }

    /// Asks for other credentials than those of a turn, unless somebody has. Returns whether there
    /// are others.
    pub(super) async fn renew(&self, used: u64) -> object_store::Result<bool> {
        let mut said = self.said.lock().await;
        if self.turn() == used {
            self.replace(&mut said, SystemTime::now()).await?;
        }
        Ok(self.turn() != used)
    }

    /// The credentials to use at a time: those said last while they hold, others otherwise.
    async fn credential_at(&self, now: SystemTime) -> object_store::Result<Arc<AwsCredential>> {
        let mut said = self.said.lock().await;
        match &*said {
            Some(known) if now < known.until => Ok(known.credential.clone()),
            _ => self.replace(&mut said, now).await,
        }
    }

    async fn replace(
        &self,
        said: &mut Option<CachedCredential>,
        now: SystemTime,
    ) -> object_store::Result<Arc<AwsCredential>> {
        let new = self.ask(now).await.map_err(|source| object_store::Error::Unauthenticated {
            path: "credentials".to_owned(),
            source: source.into(),
        })?;
        if said.as_ref().is_none_or(|old| old.credential != new.credential) {
            self.turns.fetch_add(1, Ordering::Relaxed);
        }
        Ok(said.insert(new).credential.clone())
    }

    async fn ask(&self, now: SystemTime) -> io::Result<CachedCredential> {
        let shell = if cfg!(windows) { ("cmd", "/C") } else { ("sh", "-c") };
        let mut command = tokio::process::Command::new(shell.0);
        command.args([shell.1, &self.command]).stdin(Stdio::null()).kill_on_drop(true);
        let output = tokio::time::timeout(ANSWERS_WITHIN, command.output()).await.map_err(|_| {
            let what = format!("`{}` has said nothing for {} s", self.program(), ANSWERS_WITHIN.as_secs());
            io::Error::new(io::ErrorKind::TimedOut, what)
        })??;
        let failed = |what: &str| {
            let said = String::from_utf8_lossy(&output.stderr);
            let what = format!("`{}` {what}: {}", self.program(), said.trim());
            let what = format!("{}; log in again, as by `aws sso login`", what.trim_end_matches([':', ' ']));
            io::Error::new(io::ErrorKind::PermissionDenied, what)
        };
        if !output.status.success() {
            return Err(failed("failed"));
        }
        let said: serde_json::Value = serde_json::from_slice(&output.stdout)
            .map_err(|_| failed("did not print credentials as JSON"))?;
        let get = |key: &str| said.get(key).and_then(|value| value.as_str()).map(str::to_owned);
        let (Some(key_id), Some(secret_key)) = (get("AccessKeyId"), get("SecretAccessKey")) else {
            return Err(failed("printed no credentials"));
        };
        let holds = match get("Expiration") {
            None => USED_FOR,
            Some(text) => {
                let end = chrono::DateTime::parse_from_rfc3339(text.trim()).map_err(|_| {
                    failed(&format!("printed credentials with an Expiration of `{text}`, no date"))
                })?;
                let left = SystemTime::from(end).duration_since(now);
                let left =
                    left.map_err(|_| failed(&format!("printed credentials that have expired at {text}")))?;
                left - RENEWED_BEFORE.min(left / 2)
            }
        };
        let credential = AwsCredential { key_id, secret_key, token: get("SessionToken") };
        // What is valid for longer than time goes on is asked for again after the usual time.
        let until = now.checked_add(holds).unwrap_or(now + USED_FOR);
        Ok(CachedCredential { credential: Arc::new(credential), until })
    }
}

#[async_trait]
impl CredentialProvider for Process {
    type Credential = AwsCredential;

    async fn get_credential(&self) -> object_store::Result<Arc<AwsCredential>> {
        self.credential_at(SystemTime::now()).await
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    fn run<T>(work: impl Future<Output = T>) -> T {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        runtime.expect("a runtime").block_on(work)
    }

    fn refused(command: &str) -> String {
        run(Process::new(command.to_owned()).ask(SystemTime::now())).expect_err("no credentials").to_string()
    }

    /// A command that counts its runs, says their number as the key, and a date at which it
    /// expires.
    fn counting(folder: &std::path::Path, expires: &str) -> Process {
        let count = folder.join("runs");
        let said = format!(
            r#"{{"AccessKeyId":"'$(wc -l < {0})'","SecretAccessKey":"B","Expiration":"{expires}"}}"#,
            count.display()
        );
        Process::new(format!("echo >> {}; echo '{said}'", count.display()))
    }

    fn at(date: &str) -> SystemTime {
        chrono::DateTime::parse_from_rfc3339(date).expect("a date").into()
    }

    fn key_at(process: &Process, date: &str) -> String {
        run(process.credential_at(at(date))).expect("credentials").key_id.trim().to_owned()
    }

    #[test]
    fn a_command_says_credentials_or_why_not() {
        let said = r#"echo '{"Version":1,"AccessKeyId":"A","SecretAccessKey":"B","SessionToken":"C"}'"#;
        let credential = run(Process::new(said.to_owned()).get_credential()).expect("credentials");
        assert_eq!((credential.key_id.as_str(), credential.token.as_deref()), ("A", Some("C")));
        let said = refused("echo expired >&2; exit 1");
        assert!(said.contains("failed: expired; log in again"), "{said}");
        let said = refused("KEY=secret cat secret-of-a-command");
        assert!(said.starts_with("`cat` failed") && !said.contains("KEY=secret"), "{said}");
        assert!(refused("echo {}").contains("printed no credentials; log in again"));
    }

    #[test]
    fn credentials_are_asked_for_again_five_minutes_before_they_expire_and_not_sooner() {
        let folder = tempfile::tempdir().expect("a folder");
        let process = counting(folder.path(), "2040-01-01T12:00:00Z");
        for (date, runs) in [("11:00:00", "1"), ("11:54:59", "1"), ("11:55:00", "2")] {
            assert_eq!(key_at(&process, &format!("2040-01-01T{date}Z")), runs, "{date}");
        }
        // What holds for less than ten minutes is asked for again after half of its time.
        let folder = tempfile::tempdir().expect("a folder");
        let process = counting(folder.path(), "2040-01-01T12:00:00Z");
        for (date, runs) in [("11:58:00", "1"), ("11:58:59", "1"), ("11:59:00", "2")] {
            assert_eq!(key_at(&process, &format!("2040-01-01T{date}Z")), runs, "{date}");
        }
    }

    #[test]
    fn credentials_that_have_expired_and_dates_that_are_none_are_refused() {
        let end = r#"{"AccessKeyId":"A","SecretAccessKey":"B","Expiration":"2001-02-03T04:05:06Z"}"#;
        let said = refused(&format!("echo '{end}'"));
        assert!(said.contains("have expired at 2001-02-03T04:05:06Z; log in again"), "{said}");
        assert!(refused(&format!("echo '{}'", end.replace("2001-02", "soon"))).contains("no date"));
    }

    #[test]
    fn of_many_whose_credentials_have_expired_one_asks_for_others() {
        let folder = tempfile::tempdir().expect("a folder");
        // No year that this test will see.
        let process = counting(folder.path(), "9999-01-01T12:00:00Z");
        let used = run(process.turn_now()).expect("credentials");
        for _ in 0..3 {
            assert!(run(process.renew(used)).expect("the command runs"));
        }
        assert_eq!(key_at(&process, "2040-01-01T12:00:00Z"), "2");
        // One that says the same again helps nobody.
        let process = Process::new(r#"echo '{"AccessKeyId":"A","SecretAccessKey":"B"}'"#.to_owned());
        let used = run(process.turn_now()).expect("credentials");
        assert!(!run(process.renew(used)).expect("the command runs"));
    }
}
