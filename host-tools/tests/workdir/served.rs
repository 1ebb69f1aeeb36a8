//! A running workbench and requests to it.

#![allow(dead_code)] // No test program needs all of it.

use std::io::{Read, Write};
use std::net::TcpStream;

use rustix::process::Signal;
use serde_json::Value;

use crate::workdir::WorkDir;
use crate::workdir::running::Running;

/// A running server with its address and token.
pub struct Served {
    running: Running,
    pub host: String,
    pub token: String,
}

impl Served {
    /// Serves a campaign, with more options behind it.
    pub fn start(dir: &WorkDir, campaign: &str) -> Self {
        let mut running = Running::start(dir, &format!("workbench {campaign} --json"));
        let url = running.objects().next().unwrap()["url"].as_str().unwrap().to_owned();
        let (host, token) = url.strip_prefix("http://").unwrap().split_once("/?token=").unwrap();
        Self { host: host.to_owned(), token: token.to_owned(), running }
    }

    /// Number of its process.
    pub fn id(&self) -> u32 {
        self.running.0.id()
    }

    /// Ends it without a word.
    pub fn kill(&self) {
        self.running.signal(Signal::KILL);
    }

    /// Status of a request without a body, if it is answered.
    pub fn status(&self, line: &str) -> Option<u16> {
        let mut stream = TcpStream::connect(&self.host).ok()?;
        let request =
            format!("{line} HTTP/1.1\r\nhost: {}\r\nconnection: close\r\n\r\n", self.host);
        stream.write_all(request.as_bytes()).ok()?;
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).split(' ').nth(1)?.parse().ok()
    }

    /// Status and body of a request with these header lines.
    pub fn request(&self, line: &str, headers: &str, body: &str) -> (u16, String) {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        let length = body.len();
        let request = format!(
            "{line} HTTP/1.1\r\n{headers}content-type: application/json\r\ncontent-length: {length}\r\nconnection: close\r\n\r\n{body}"
        );
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        (head.split(' ').nth(1).unwrap().parse().unwrap(), body.to_owned())
    }

    /// Answer to a request of the page.
    pub fn ask(&self, path: &str, body: &Value) -> (u16, Value) {
        let headers = format!("host: {}\r\nx-token: {}\r\n", self.host, self.token);
        let (status, body) = self.request(&format!("POST /{path}"), &headers, &body.to_string());
        (status, serde_json::from_str(&body).unwrap())
    }
}
