//! Credentials that the server says have expired are renewed where that can be done, and the
//! request made once more.

use std::future::Future;
use std::sync::Arc;

use object_store::Error;

use super::credential_process::Process;
use super::failure;

/// Who renews the credentials of a client; by default nobody.
#[derive(Clone, Debug, Default)]
pub(super) struct Renewal(Option<Arc<Process>>);

impl Renewal {
    /// Renewal by the command that said them.
    pub(super) fn by(process: Arc<Process>) -> Self {
        Self(Some(process))
    }

    /// Makes a request, and once more with other credentials if those that it was made with have
    /// expired.
    pub(super) async fn with<T, F: Future<Output = Result<T, Error>>>(
        &self,
        mut work: impl FnMut() -> F,
    ) -> Result<T, Error> {
        let Some(process) = &self.0 else { return work().await };
        let used = process.turn_now().await?;
        match work().await {
            Err(error) if failure::is_expired(&error) => {
                if process.renew(used).await? {
                    work().await
                } else {
                    Err(error)
                }
            }
            outcome => outcome,
        }
    }
}
