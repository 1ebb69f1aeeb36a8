//! Servers on this machine. Everybody who reaches the port may connect, also pages of other sites in a browser: connections are
//! few, and each must go on in time.

use std::convert::Infallible;
use std::io::Write;
use std::net::IpAddr;
use std::sync::Arc;
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
use tokio::time::{sleep, timeout};
use tokio_io_timeout::TimeoutStream;

/// Connections at a time.
const MAX_CONNECTIONS: usize = 64;
/// Time for the body of a request, and without progress of an answer.
const TIME_OUT: Duration = Duration::from_secs(10);
/// Time for the head of a request, also of the next one on a connection: connections without one keep others out for less than ten
/// seconds.
const HEAD_TIME_OUT: Duration = Duration::from_millis(9500);
/// Maximum length of a request's head and of its body in bytes: some formulas, and the cookies of other servers on this machine.
const MAX_BYTES: usize = 64 << 10;
/// Pause after a connection that could not be accepted.
const PAUSE: Duration = Duration::from_millis(100);
/// Answer without a place.
const BUSY: &[u8] =
    b"HTTP/1.1 503 Service Unavailable\r\nconnection: close\r\ncontent-type: text/plain\r\n\r\n\
                      There are too many connections: try again in ten seconds.\n";

/// Place of a connection; who takes the connection over keeps the place.
pub type Place = Arc<OwnedSemaphorePermit>;

/// Addresses of both ends of a connection: of this machine.
#[derive(Clone, Copy, Debug)]
pub struct OwnAddress(pub IpAddr);

/// Serves without end.
pub async fn serve(listener: TcpListener, router: Router) -> Infallible {
    let places = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            sleep(PAUSE).await;
            continue;
        };
        let Ok(place) = places.clone().try_acquire_owned().map(Place::new) else {
            // A new connection has room for it; a client that does not receive it finds it closed.
            let _ = stream.into_std().and_then(|mut stream| stream.write_all(BUSY));
            continue;
        };
        let Ok(address) = stream.local_addr() else { continue };
        let _ = stream.set_nodelay(true);
        let mut stream = TimeoutStream::new(stream);
        stream.set_write_timeout(Some(TIME_OUT));
        let router =
            router.clone().layer(Extension(OwnAddress(address.ip()))).layer(Extension(place));
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(HEAD_TIME_OUT)
            .max_buf_size(MAX_BYTES)
            .serve_connection(TokioIo::new(Box::pin(stream)), TowerToHyperService::new(router))
            .with_upgrades();
        // Who disconnects is no error.
        tokio::spawn(async move { drop(connection.await) });
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
