//! `magpie workbench`: a page on this machine in which models of a campaign are built and compared.

use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use analysis::workbench::{Stretch, Workbench};
use anyhow::{Context, Result, anyhow};
use axum::extract::{DefaultBodyLimit, Query, Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::inverse::build::{ModelVariant, build};
use model_export::inverse::codegen::{self, tables_source};
use model_export::model_file;
use model_export::output::{check_output, write_output};
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::recording_folders;
use report::html::workbench as pages;
use report::text::terminal;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::commands::args::{AlignArgs, parse_formulas, parse_range};

/// Open a page in a browser of this machine: add effects and formulas to a model of a campaign, and every number and plot follows.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie workbench tests/data/friction
  cargo magpie workbench my-campaign --http-port 8080

It serves the printed address on this machine only, until Ctrl-C. Only who has the address, which contains a random token, can use
it. Everything that the page does is the command that it shows.")]
pub struct Args {
    /// Folder of recordings (or one recording).
    campaign: PathBuf,
    /// TCP port on 127.0.0.1; 0 selects a free one.
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    http_port: u16,
    #[command(flatten)]
    align: AlignArgs,
    /// Seed of the bootstrap.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print one JSON object with the address on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Maximum length of a request in bytes: some formulas.
const MAX_REQUEST_BYTES: usize = 64 << 10;
/// What the page may load: only itself.
const CONTENT_POLICY: &str = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; \
                              connect-src 'self'; form-action 'none'; base-uri 'none'; frame-ancestors 'none'";

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let alignment = args.align.alignment()?;
    recording_folders(&args.campaign)?;
    let mut token = [0; 16];
    getrandom::fill(&mut token).context("the system has no random numbers")?;
    let token: String = token.iter().map(|byte| format!("{byte:02x}")).collect();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_io()
        .enable_time()
        .build();
    let runtime = runtime.context("the server cannot be started")?;
    runtime.block_on(async {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.http_port));
        let listener = tokio::net::TcpListener::bind(address).await;
        let listener =
            listener.with_context(|| format!("port {} cannot be used", args.http_port))?;
        let address = listener.local_addr()?;
        let url = format!("http://{address}/?token={token}");
        if args.json {
            terminal::print(&format!("{}\n", json!({ "url": url })))?;
        } else {
            terminal::print(&format!(
                "Workbench: {url}\nOpen it in a browser of this machine; Ctrl-C ends it.\n"
            ))?;
        }
        let server = Server {
            bench: Arc::default(),
            campaign: Arc::new(args.campaign.clone()),
            alignment,
            options: FitOptions { seed: args.seed, ..FitOptions::default() },
            token: token.into(),
            host: address.to_string().into(),
        };
        axum::serve(listener, router(server)).await.context("the server ended")
    })
}

/// State of the server.
#[derive(Clone)]
struct Server {
    /// The models; opened by the first request, since the page appears before the base is fitted.
    bench: Arc<Mutex<Option<Workbench>>>,
    campaign: Arc<PathBuf>,
    alignment: Alignment,
    options: FitOptions,
    token: Arc<str>,
    host: Arc<str>,
}

fn router(server: Server) -> Router {
    Router::new()
        .route("/", get(page))
        .route("/model", post(model))
        .route("/names", post(names))
        .route("/diagnose", post(diagnose))
        .route("/scatter", post(scatter))
        .route("/write", post(write))
        .layer(DefaultBodyLimit::max(MAX_REQUEST_BYTES))
        .layer(middleware::from_fn_with_state(server.clone(), authorise))
        .with_state(server)
}

#[derive(Deserialize)]
struct Access {
    #[serde(default)]
    token: String,
}

/// Refuses requests without the token, and those that another page sends under a name of its own for this address.
async fn authorise(
    State(server): State<Server>,
    Query(Access { token }): Query<Access>,
    headers: HeaderMap,
    request: Request,
    next: Next,
) -> Response {
    let of_header =
        |name: &str| headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or("");
    let is_page = request.uri().path() == "/";
    let given = if is_page { token.as_str() } else { of_header("x-token") };
    if of_header("host") != &*server.host || given != &*server.token {
        return (StatusCode::FORBIDDEN, "Use the address that the command printed.\n")
            .into_response();
    }
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(CONTENT_POLICY));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    response
}

async fn page(State(server): State<Server>) -> Html<String> {
    Html(pages::page(&server.campaign.display().to_string()))
}

/// Effects of the catalogue and formulas of a model. Ranges of a formula follow it after semicolons.
#[derive(Clone, Debug, Default, Deserialize)]
struct Choice {
    effects: Vec<String>,
    formulas: Vec<String>,
}

#[derive(Deserialize)]
struct ModelRequest {
    #[serde(flatten)]
    choice: Choice,
    baseline: Option<Choice>,
}

#[derive(Deserialize)]
struct WriteRequest {
    #[serde(flatten)]
    choice: Choice,
    baseline: Option<Choice>,
    kind: Kind,
    path: PathBuf,
}

/// What is written.
#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Kind {
    Model,
    Tables,
    Report,
}

async fn model(State(server): State<Server>, Json(request): Json<ModelRequest>) -> Response {
    answer(server, move |bench| {
        let terms = request.choice.terms(bench)?;
        let baseline = request.baseline.map(|choice| choice.terms(bench)).transpose()?;
        if let Some(baseline) = &baseline {
            bench.fit_model(baseline)?;
        }
        bench.fit_model(&terms)?;
        let shown = bench.fitted(&terms).context("the model is gone")?;
        let baseline = baseline.and_then(|terms| bench.fitted(&terms));
        Ok(pages::state(bench, shown, baseline))
    })
    .await
}

async fn names(State(server): State<Server>) -> Response {
    answer(server, |bench| Ok(pages::formula_names(bench))).await
}

#[derive(Deserialize)]
struct DiagnosisRequest {
    #[serde(flatten)]
    choice: Choice,
    /// Whether to plan the next recording.
    plans: bool,
}

async fn diagnose(State(server): State<Server>, Json(request): Json<DiagnosisRequest>) -> Response {
    answer(server, move |bench| {
        let terms = request.choice.terms(bench)?;
        bench.fit_model(&terms)?;
        Ok(pages::diagnosis(&bench.diagnose(&terms, request.plans)?))
    })
    .await
}

#[derive(Deserialize)]
struct ScatterRequest {
    // Not flattened: numbers of flattened structures are not read where a dependency enables serde_json's arbitrary precision.
    choice: Choice,
    covariate: String,
    stretch: Stretch,
}

async fn scatter(State(server): State<Server>, Json(request): Json<ScatterRequest>) -> Response {
    answer(server, move |bench| {
        let terms = request.choice.terms(bench)?;
        bench.fit_model(&terms)?;
        let found = bench.scatter(&terms, &request.covariate, &request.stretch)?;
        Ok(json!({ "plot": pages::scatter(&found) }))
    })
    .await
}

async fn write(State(server): State<Server>, Json(request): Json<WriteRequest>) -> Response {
    answer(server, move |bench| {
        let terms = request.choice.terms(bench)?;
        let baseline = request.baseline.map(|choice| choice.terms(bench)).transpose()?;
        bench.fit_model(&terms)?;
        let shown = bench.fitted(&terms).context("the model is gone")?;
        let baseline = baseline.and_then(|terms| bench.fitted(&terms));
        let path = &request.path;
        let message = match request.kind {
            Kind::Model => {
                shown.model.write(path)?;
                format!("Written to {}.", path.display())
            }
            Kind::Report => {
                report::html::write(path, &pages::with_baseline(shown, baseline), &[])?;
                format!("Written to {}.", path.display())
            }
            Kind::Tables => {
                let model = path.with_extension("toml");
                check_output(path, codegen::MARK)?;
                check_output(&model, model_file::SIGNATURE)?;
                shown.model.write(&model)?;
                let built = build(&model, ModelVariant::Fitted)?;
                write_output(path, tables_source(&built).as_bytes(), codegen::MARK)?;
                format!("Written to {}, with its model {}.", path.display(), model.display())
            }
        };
        Ok(json!({ "message": message }))
    })
    .await
}

impl Choice {
    fn terms(&self, bench: &Workbench) -> Result<Vec<EffectTerm>> {
        let mut formulas = Vec::new();
        for text in &self.formulas {
            let mut parts = text.split(';');
            let formula = parts.next().unwrap_or_default().trim().to_owned();
            let ranges =
                parts.map(|range| parse_range(range).map_err(|error| anyhow!("{range}: {error}")));
            formulas.extend(parse_formulas(
                &[formula],
                &ranges.collect::<Result<Vec<_>>>()?,
                &bench.covariates(),
            )?);
        }
        analysis::edit_model::find_effects(&self.effects, &formulas)
    }
}

/// Runs a request on a thread that may block; one at a time.
async fn answer(
    server: Server,
    work: impl FnOnce(&mut Workbench) -> Result<Value> + Send + 'static,
) -> Response {
    let done = tokio::task::spawn_blocking(move || {
        let mut bench = server.bench.lock().unwrap_or_else(PoisonError::into_inner);
        let open = || Workbench::open(&server.campaign, server.alignment, server.options);
        let bench = match &mut *bench {
            Some(bench) => bench,
            empty => empty.insert(open()?),
        };
        work(bench)
    });
    let failed = |status, error: String| (status, Json(json!({ "error": error }))).into_response();
    match done.await {
        Ok(Ok(value)) => Json(value).into_response(),
        Ok(Err(error)) => failed(StatusCode::UNPROCESSABLE_ENTITY, format!("{error:#}")),
        Err(_) => failed(
            StatusCode::INTERNAL_SERVER_ERROR,
            "the request ended with an internal error".to_owned(),
        ),
    }
}
