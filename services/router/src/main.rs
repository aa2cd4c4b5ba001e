//! A Zenoh router with the storage manager (memory volume) and REST linked in. Plugins loaded as
//! `.so` check compiler, version and features and still crash on differing dependencies
//! (eclipse-zenoh/zenoh#1745). So none is loaded: every plugin that the configuration names must be
//! linked in.

mod options;

use std::process::ExitCode;
use std::time::Duration;

use zenoh::internal::plugins::PluginsManager;
use zenoh::internal::runtime::{Runtime, RuntimeBuilder};
use zenoh::Config;

use options::{parse, Action, Options, HELP};

const EXIT_FAILURE: u8 = 1;
const EXIT_USAGE: u8 = 2;
const EXIT_START: u8 = 3;
/// Closing can hang on a bad link (eclipse-zenoh/zenoh#2675); a router has nothing to save.
const CLOSE_DEADLINE: Duration = Duration::from_secs(4);
const HEALTH_DEADLINE: Duration = Duration::from_secs(3);

fn main() -> ExitCode {
    let options = match parse(std::env::args().skip(1)) {
        Ok(options) => options,
        Err(text) => return complain(EXIT_USAGE, &format!("{text} (see --help)")),
    };
    match options.action {
        Action::Help => {
            print!("{HELP}");
            return ExitCode::SUCCESS;
        }
        Action::Version => {
            println!("zloam-router {} (zenoh 1.10.2)", env!("CARGO_PKG_VERSION"));
            return ExitCode::SUCCESS;
        }
        _ => {}
    }
    let runtime = match tokio::runtime::Runtime::new() {
        Ok(runtime) => runtime,
        Err(e) => return complain(EXIT_FAILURE, &e.to_string()),
    };
    if let Action::Health(endpoint) = &options.action {
        let config = match client_configuration(endpoint, &options.settings) {
            Ok(config) => config,
            Err(text) => return complain(EXIT_USAGE, &text),
        };
        return match runtime.block_on(health(endpoint, config)) {
            Ok(()) => ExitCode::SUCCESS,
            Err(text) => complain(EXIT_FAILURE, &text),
        };
    }
    let config = match configuration(&options) {
        Ok(config) => config,
        Err(text) => return complain(EXIT_USAGE, &text),
    };
    if matches!(options.action, Action::Check) {
        println!("{}", effective(&config));
        return ExitCode::SUCCESS;
    }
    zenoh::init_log_from_env_or("warn");
    let code = runtime.block_on(route(config));
    // A hanging thread of Zenoh must not keep the process alive.
    runtime.shutdown_background();
    code
}

fn complain(code: u8, text: &str) -> ExitCode {
    eprintln!("zloam-router: {text}");
    ExitCode::from(code)
}

/// The configuration: the file, then the settings in their order.
fn configuration(options: &Options) -> Result<Config, String> {
    let mut config = match &options.config {
        Some(path) => Config::from_file(path).map_err(|e| format!("{path}: {e}"))?,
        None => Config::default(),
    };
    if !is_set(&config, "mode") {
        config.insert_json5("mode", "\"router\"").map_err(|e| e.to_string())?;
    }
    set(&mut config, &options.settings)?;
    check_rest(&config)?;
    Ok(config)
}

/// The settings of `--set`, in their order.
fn set(config: &mut Config, settings: &[(String, String)]) -> Result<(), String> {
    for (key, value) in settings {
        // Bare words are taken as strings, because shells remove quotes.
        let json = match json5::from_str::<serde_json::Value>(value) {
            Ok(_) => value.clone(),
            Err(_) => serde_json::Value::from(value.as_str()).to_string(),
        };
        config
            .insert_json5(key, &json)
            .map_err(|e| format!("--set {key}: value '{value}' is refused: {e}"))?;
    }
    Ok(())
}

fn is_set(config: &Config, key: &str) -> bool {
    matches!(config.get_json(key).as_deref(), Ok(text) if text != "null")
}

/// REST acts as the router itself and bypasses the access rules of its links, so an address is
/// required: a bare port would open it on all interfaces.
fn check_rest(config: &Config) -> Result<(), String> {
    let Ok(text) = config.get_json("plugins/rest/http_port") else {
        return Ok(());
    };
    match serde_json::from_str::<serde_json::Value>(&text) {
        Ok(serde_json::Value::Null) | Err(_) => Ok(()),
        Ok(serde_json::Value::String(address)) if address.contains(':') => Ok(()),
        Ok(other) => Err(format!(
            "plugins/rest/http_port: value {other} is refused: an address with a port is expected, \
             e.g. 127.0.0.1:8000 (a bare port opens it on all interfaces)"
        )),
    }
}

fn effective(config: &Config) -> String {
    let mut out = serde_json::Map::new();
    for key in ["mode", "listen", "connect", "plugins", "access_control", "downsampling"] {
        let value = config.get_json(key).ok().and_then(|text| serde_json::from_str(&text).ok());
        out.insert(key.to_string(), value.unwrap_or(serde_json::Value::Null));
    }
    serde_json::to_string_pretty(&serde_json::Value::Object(out)).unwrap_or_default()
}

async fn route(config: Config) -> ExitCode {
    let term = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate());
    let Ok(mut term) = term else {
        return complain(EXIT_FAILURE, "SIGTERM can't be caught");
    };
    let listen = config.get_json("listen/endpoints").unwrap_or_default();
    let runtime = match start(config).await {
        Ok(runtime) => runtime,
        Err(text) => return complain(EXIT_START, &text),
    };
    eprintln!("zloam-router: ready, id {}, listening on {listen}", runtime.zid());
    tokio::select! { _ = term.recv() => {}, _ = tokio::signal::ctrl_c() => {} }
    match tokio::time::timeout(CLOSE_DEADLINE, runtime.close()).await {
        Ok(Ok(())) => eprintln!("zloam-router: ended"),
        Ok(Err(e)) => eprintln!("zloam-router: ended, though closing said: {e}"),
        Err(_) => eprintln!("zloam-router: ended, a link did not close in time"),
    }
    ExitCode::SUCCESS
}

async fn start(config: Config) -> Result<Runtime, String> {
    let mut plugins = PluginsManager::static_plugins_only();
    if is_set(&config, "plugins/storage_manager") {
        plugins.declare_static_plugin::<zenoh_plugin_storage_manager::StoragesPlugin, _>(
            "storage_manager",
            true,
        );
    }
    if is_set(&config, "plugins/rest") {
        plugins.declare_static_plugin::<zenoh_plugin_rest::RestPlugin, _>("rest", true);
    }
    let mut runtime = RuntimeBuilder::new(config.into())
        .plugins_manager(plugins)
        .build()
        .await
        .map_err(|e| e.to_string())?;
    runtime.start().await.map_err(|e| e.to_string())?;
    Ok(runtime)
}

/// The configuration of a client of the router at the endpoint.
fn client_configuration(endpoint: &str, settings: &[(String, String)]) -> Result<Config, String> {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", "\"client\"".to_string()),
        ("connect/endpoints", serde_json::json!([endpoint]).to_string()),
        ("scouting/multicast/enabled", "false".to_string()),
        ("transport/shared_memory/enabled", "false".to_string()),
    ] {
        config.insert_json5(key, &value).map_err(|e| e.to_string())?;
    }
    set(&mut config, settings)?;
    Ok(config)
}

/// Asks a running router for its admin space, as any client would.
async fn health(endpoint: &str, config: Config) -> Result<(), String> {
    let ask = async {
        let session = zenoh::open(config).await.map_err(|e| e.to_string())?;
        let replies = session.get("@/*/router").await.map_err(|e| e.to_string())?;
        let reply = replies.recv_async().await.map_err(|_| "no answer".to_string())?;
        reply.result().map(|_| ()).map_err(|e| format!("{:?}", e.payload()))
    };
    match tokio::time::timeout(HEALTH_DEADLINE, ask).await {
        Ok(result) => result.map_err(|e| format!("{endpoint}: {e}")),
        Err(_) => Err(format!("{endpoint}: no answer in {} s", HEALTH_DEADLINE.as_secs())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(words: &[(&str, &str)]) -> Vec<(String, String)> {
        words.iter().map(|(key, value)| (key.to_string(), value.to_string())).collect()
    }

    #[test]
    fn health_takes_bare_words_as_the_router_does() {
        let certificate =
            ("transport/link/tls/root_ca_certificate", "/etc/zloam/tls/authority.crt");
        let words = settings(&[certificate, ("transport/link/tx/lease", "3000")]);
        let config = client_configuration("tls/robot:7448", &words).unwrap();
        assert_eq!(config.get_json(certificate.0).unwrap(), format!("\"{}\"", certificate.1));
        assert_eq!(config.get_json("transport/link/tx/lease").unwrap(), "3000");
        assert_eq!(config.get_json("mode").unwrap(), "\"client\"");
    }

    #[test]
    fn a_refused_setting_is_named() {
        for words in [settings(&[("mode", "none")]), settings(&[("nothing/here", "1")])] {
            let text = client_configuration("tcp/robot:7447", &words).unwrap_err();
            assert!(text.contains(&format!("--set {}", words[0].0)), "{text}");
        }
    }
}
