//! `zloam-mcap-reader FILE`: what the crate `mcap` finds in a recording, as one line of JSON: messages, bytes and the
//! CRC-32 of the data of each topic in the file's order, how many messages its index names, and where it had to stop.

use std::{collections::BTreeMap, error::Error, fs};

use mcap::{read::Options, MessageStream, Summary};
use serde_json::{json, Value};

#[derive(Default)]
struct Topic {
    messages: u64,
    bytes: usize,
    crc: crc32fast::Hasher,
}

/// By topic; of a file that was cut off what lies before the cut, and what is wrong there.
fn counted(file: &[u8]) -> mcap::McapResult<(BTreeMap<String, Topic>, Option<String>)> {
    let mut topics = BTreeMap::<String, Topic>::new();
    // The end is judged by the index, so that one who has lost it is read too.
    for message in MessageStream::new_with_options(file, Options::IgnoreEndMagic.into())? {
        let message = match message {
            Ok(message) => message,
            Err(error) => return Ok((topics, Some(error.to_string()))),
        };
        let topic = topics.entry(message.channel.topic.clone()).or_default();
        topic.messages += 1;
        topic.bytes += message.data.len();
        topic.crc.update(&message.data);
    }
    Ok((topics, None))
}

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args_os().nth(1).ok_or("usage: zloam-mcap-reader FILE")?;
    let file = fs::read(path)?;
    let (topics, stopped) = counted(&file)?;
    let indexed = Summary::read(&file).ok().flatten().and_then(|s| s.stats);
    let told: BTreeMap<String, Value> = topics
        .into_iter()
        .map(|(name, t)| {
            (name, json!({"messages": t.messages, "bytes": t.bytes, "crc32": t.crc.finalize()}))
        })
        .collect();
    let indexed = indexed.map(|stats| stats.message_count);
    println!("{}", json!({"topics": told, "indexed": indexed, "stopped": stopped}));
    Ok(())
}
