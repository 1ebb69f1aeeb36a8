//! Servers on this machine. Everybody who reaches the port may connect, also pages of other sites in a browser: connections are
//! few, and each must go on in time.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::io::Write;
use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

use axum::body::{Body, to_bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpListener;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::AbortHandle;
use tokio::time::{sleep, timeout};
use tokio_io_timeout::TimeoutStream;

/// Connections at a time.
const MAX_CONNECTIONS: usize = 64;
/// Time for the head of a request, also of the next one on a connection; for its body; and without progress of an answer.
const TIME_OUT: Duration = Duration::from_secs(10);
/// Maximum length of a request's head and of its body in bytes: some formulas, and the cookies of other servers on this machine.
const MAX_BYTES: usize = 64 << 10;
/// Pause after a connection that could not be accepted.
const PAUSE: Duration = Duration::from_millis(100);
/// Pause after a connection that was closed for another.
const PACE: Duration = Duration::from_millis(5);
/// Answer without a place.
const BUSY: &[u8] =
    b"HTTP/1.1 503 Service Unavailable\r\nconnection: close\r\ncontent-type: text/plain\r\n\r\n\
                      There are too many connections: try again in ten seconds.\n";

/// Place of a connection; who takes the connection over keeps the place.
pub struct Place {
    _permit: OwnedSemaphorePermit,
    is_admitted: AtomicBool,
}

impl Place {
    /// Keeps the place: the client has shown that it may use the server. Others leave theirs to the next one where all are taken.
    pub fn admit(&self) {
        self.is_admitted.store(true, Ordering::Relaxed);
    }

    fn is_admitted(&self) -> bool {
        self.is_admitted.load(Ordering::Relaxed)
    }
}

/// Addresses of both ends of a connection: of this machine.
#[derive(Clone, Copy, Debug)]
pub struct OwnAddress(pub IpAddr);

/// Serves without end.
pub async fn serve(listener: TcpListener, router: Router) -> Infallible {
    let places = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    // The oldest first.
    let mut connections: VecDeque<(Weak<Place>, AbortHandle)> = VecDeque::new();
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            sleep(PAUSE).await;
            continue;
        };
        connections.retain(|(place, _)| place.upgrade().is_some_and(|place| !place.is_admitted()));
        if places.available_permits() == 0
            && let Some((_, oldest)) = connections.pop_front()
        {
            oldest.abort();
            // As long as a client has at least, in all places, for its first request.
            sleep(PACE).await;
        }
        let Ok(permit) = places.clone().try_acquire_owned() else {
            // A new connection has room for it; a client that does not receive it finds it closed.
            let _ = stream.into_std().and_then(|mut stream| stream.write_all(BUSY));
            continue;
        };
        let place = Arc::new(Place { _permit: permit, is_admitted: AtomicBool::new(false) });
        let known = Arc::downgrade(&place);
        let Ok(address) = stream.local_addr() else { continue };
        let _ = stream.set_nodelay(true);
        let mut stream = TimeoutStream::new(stream);
        stream.set_write_timeout(Some(TIME_OUT));
        let router =
            router.clone().layer(Extension(OwnAddress(address.ip()))).layer(Extension(place));
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(TIME_OUT)
            .max_buf_size(MAX_BYTES)
            .serve_connection(TokioIo::new(Box::pin(stream)), TowerToHyperService::new(router))
            .with_upgrades();
        // Who disconnects is no error.
        let task = tokio::spawn(async move { drop(connection.await) });
        connections.push_back((known, task.abort_handle()));
    }
}

/// Reads the whole body of a request, in time and of limited length.
pub async fn read_body(request: Request, next: Next) -> Response {
    let (head, body) = request.into_parts();
    match timeout(TIME_OUT, to_bytes(body, MAX_BYTES)).await {
        Ok(Ok(body)) => next.run(Request::from_parts(head, Body::from(body))).await,
        Ok(Err(_)) => refuse(StatusCode::PAYLOAD_TOO_LARGE, "The request is too long.\n"),
        Err(_) => refuse(StatusCode::REQUEST_TIMEOUT, "The request did not come in time.\n"),
    }
}

/// A refusal, after which the connection is closed.
pub fn refuse(status: StatusCode, reason: &'static str) -> Response {
    (status, [(header::CONNECTION, "close")], reason).into_response()
}

/// The only value of a header; `None` if there is none, or several.
pub fn single<'h>(headers: &'h HeaderMap, name: &header::HeaderName) -> Option<&'h str> {
    let mut values = headers.get_all(name).iter();
    values.next().filter(|_| values.next().is_none())?.to_str().ok()
}
