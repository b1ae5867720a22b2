//! Connections: no more than can be served, and none that is silent for long.

use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::serve::Listener;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, Sleep, sleep, sleep_until};

/// Most connections at a time. A page holds one, and asks for its files with a few more.
const MOST: usize = 128;
/// A socket that says nothing for so long is closed. Pages answer a ping more often than that.
const SILENCE: Duration = Duration::from_secs(30);
/// A request must have come, whole, this long after the connection was made or the last answer was
/// given: visitors without credentials do not hold places by bytes that trickle in.
const REQUEST: Duration = Duration::from_secs(5);
/// How the answer begins that makes a connection a socket.
const SWITCHED: &[u8] = b"HTTP/1.1 101";

/// Accepts connections, as many as may be open at a time; further ones are closed at once.
pub(crate) struct Limited {
    listener: TcpListener,
    places: Arc<Semaphore>,
}

impl Limited {
    pub(crate) fn new(listener: TcpListener) -> Self {
        Self { listener, places: Arc::new(Semaphore::new(MOST)) }
    }
}

impl Listener for Limited {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        loop {
            match self.listener.accept().await {
                Ok((stream, address)) => {
                    if let Ok(place) = self.places.clone().try_acquire_owned() {
                        // Frames are small and wanted at once.
                        let _ = stream.set_nodelay(true);
                        let end = Box::pin(sleep(REQUEST));
                        return (Connection { stream, end, is_socket: false, _place: place }, address);
                    }
                }
                // The process has no more file descriptors, or the visitor has gone again.
                Err(_) => sleep(Duration::from_millis(50)).await,
            }
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

/// A connection that ends when a request takes too long, or when a socket is silent.
pub(crate) struct Connection {
    stream: TcpStream,
    /// When it is closed if no request has been answered, or nothing been heard of a socket, until
    /// then.
    end: Pin<Box<Sleep>>,
    is_socket: bool,
    _place: OwnedSemaphorePermit,
}

impl Connection {
    /// Takes note of an answer, or a part of one.
    fn answered(&mut self, bytes: &[u8]) {
        self.is_socket |= bytes.starts_with(SWITCHED);
        if !self.is_socket {
            self.end.set(sleep_until(Instant::now() + REQUEST));
        }
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.stream).poll_read(context, buffer);
        match read {
            Poll::Pending => self.end.as_mut().poll(context).map(|()| Err(io::ErrorKind::TimedOut.into())),
            Poll::Ready(_) => {
                if self.is_socket && buffer.filled().len() > before {
                    self.end.set(sleep_until(Instant::now() + SILENCE));
                }
                read
            }
        }
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        if matches!(written, Poll::Ready(Ok(_))) {
            self.answered(bytes);
        }
        written
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, bytes);
        if matches!(written, Poll::Ready(Ok(_))) {
            self.answered(bytes.first().map(|first| &**first).unwrap_or_default());
        }
        written
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}
