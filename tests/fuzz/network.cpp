#include "network.hpp"

#include <algorithm>
#include <ctime>
#include <memory>
#include <mutex>

#include "common/messages/key_match.hpp"
#include "common/zenoh/bridge/include/zloam_zenoh.h"

struct zloam_bytes {
  const std::uint8_t* data;
  std::size_t size;
  void* context;
  zloam_drop_fn drop;
};
struct zloam_config {};
struct zloam_session {};
struct zloam_publisher {
  std::string encoding;
};
struct zloam_token {};
struct zloam_query {
  std::string key, parameters;
  std::vector<std::uint8_t> payload;
};
struct zloam_subscriber {
  std::string key;
  bool of_tokens;
  zloam_on_sample call;
  void* context;
  zloam_drop_fn drop;
};
struct zloam_queryable {
  std::string key;
  zloam_on_query call;
  void* context;
  zloam_drop_fn drop;
};

// A stage sleeps while it waits for a link. Here every link exists, so sleeping is skipped.
extern "C" int nanosleep(const timespec*, timespec*) { return 0; }

namespace {

using zloam::fuzz::NetMessage;

std::mutex mutex;
zloam::fuzz::Network network;
std::vector<zloam_subscriber*> subscribers;
std::vector<zloam_queryable*> queryables;

std::string text(zloam_slice s) {
  return {reinterpret_cast<const char*>(s.data), s.data == nullptr ? 0 : s.size};
}
zloam_slice slice(std::string_view s) {
  return {reinterpret_cast<const std::uint8_t*>(s.data()), s.size()};
}

/// Allocated with exactly this size, so that AddressSanitizer detects reads beyond the end.
zloam_bytes* copied(std::span<const std::uint8_t> bytes) {
  auto* data = new std::uint8_t[bytes.size()];
  std::copy(bytes.begin(), bytes.end(), data);
  return new zloam_bytes{data, bytes.size(), data,
                         [](void* p) { delete[] static_cast<std::uint8_t*>(p); }};
}

zloam_sample sample_of(const NetMessage& m, std::uint8_t kind) {
  return {slice(m.key), slice(m.encoding), copied(m.payload), nullptr, kind, 5, 0, false};
}

template <class Entity>
std::vector<Entity*> all(const std::vector<Entity*>& entities) {
  const std::lock_guard lock(mutex);
  return entities;
}

template <class Entity>
void undeclare(std::vector<Entity*>& entities, Entity* entity) {
  if (entity == nullptr) return;
  {
    const std::lock_guard lock(mutex);
    std::erase(entities, entity);
  }
  entity->drop(entity->context);
  delete entity;
}

void deliver(const NetMessage& m, bool token, std::uint8_t kind) {
  for (const zloam_subscriber* s : all(subscribers)) {
    if (s->of_tokens != token || !zloam::key_matches(s->key, m.key)) continue;
    const zloam_sample sample = sample_of(m, kind);
    s->call(s->context, &sample);
  }
}

zloam_status published(const std::string& encoding, const zloam_bytes* payload) {
  if (network.on_put && payload != nullptr) {
    network.on_put(encoding, {payload->data, payload->size});
  }
  return ZLOAM_OK;
}

}  // namespace

namespace zloam::fuzz {

void set_network(Network n) { network = std::move(n); }

void send(const NetMessage& message) { deliver(message, false, 0); }

void send_token(const std::string& key, bool there) { deliver({key, {}, {}}, true, there ? 0 : 1); }

void ask(const NetMessage& question, const std::string& parameters) {
  for (const zloam_queryable* q : all(queryables)) {
    if (!key_matches(q->key, question.key) && !key_matches(question.key, q->key)) continue;
    q->call(q->context, new zloam_query{question.key, parameters, question.payload});
  }
}

}  // namespace zloam::fuzz

extern "C" {

const char* zloam_last_error(void) { return "the fuzzer's network"; }
zloam_status zloam_init_log(zloam_slice) { return ZLOAM_OK; }

zloam_status zloam_bytes_own(const std::uint8_t* data, std::size_t size, void* context,
                             zloam_drop_fn drop, zloam_bytes** out) {
  *out = new zloam_bytes{data, size, context, drop};
  return ZLOAM_OK;
}
zloam_status zloam_bytes_copy(zloam_slice data, zloam_bytes** out) {
  *out = copied({data.data, data.size});
  return ZLOAM_OK;
}
zloam_status zloam_bytes_in_parts(const zloam_bytes* bytes, std::size_t, zloam_bytes** out) {
  *out = copied({bytes->data, bytes->size});
  return ZLOAM_OK;
}
void zloam_bytes_drop(zloam_bytes* bytes) {
  if (bytes == nullptr) return;
  bytes->drop(bytes->context);
  delete bytes;
}
std::size_t zloam_bytes_size(const zloam_bytes* bytes) { return bytes->size; }
bool zloam_bytes_is_shared_memory(const zloam_bytes*) { return false; }
bool zloam_bytes_is_intact(const zloam_bytes*) { return true; }
bool zloam_bytes_view(const zloam_bytes* bytes, zloam_slice* out) {
  *out = {bytes->data, bytes->size};
  return true;
}
void zloam_bytes_copy_to(const zloam_bytes* bytes, std::uint8_t* destination) {
  std::copy_n(bytes->data, bytes->size, destination);
}

zloam_status zloam_config_default(zloam_config** out) {
  *out = new zloam_config;
  return ZLOAM_OK;
}
zloam_status zloam_config_from_text(zloam_slice, zloam_config** out) {
  return zloam_config_default(out);
}
zloam_status zloam_config_from_file(zloam_slice, zloam_config** out) {
  return zloam_config_default(out);
}
zloam_status zloam_config_insert(zloam_config*, zloam_slice, zloam_slice) { return ZLOAM_OK; }
void zloam_config_drop(zloam_config* config) { delete config; }

zloam_status zloam_session_open(const zloam_config*, zloam_session** out) {
  *out = new zloam_session;
  return ZLOAM_OK;
}
zloam_status zloam_session_close(const zloam_session*, std::uint64_t, bool* closed) {
  *closed = true;
  return ZLOAM_OK;
}
void zloam_session_drop(zloam_session* session) { delete session; }
std::size_t zloam_session_zid(const zloam_session*, std::uint8_t* buffer, std::size_t) {
  buffer[0] = '1';
  return 1;
}
std::size_t zloam_session_links(const zloam_session*, std::uint8_t*, std::size_t) { return 0; }

zloam_status zloam_session_declare_publisher(const zloam_session*, zloam_slice,
                                             const zloam_publisher_options* options,
                                             zloam_publisher** out) {
  *out = new zloam_publisher{text(options->encoding)};
  return ZLOAM_OK;
}
zloam_status zloam_publisher_put(const zloam_publisher* publisher, const zloam_bytes* payload,
                                 const zloam_bytes*) {
  return published(publisher->encoding, payload);
}
zloam_status zloam_publisher_delete(const zloam_publisher*) { return ZLOAM_OK; }
zloam_status zloam_publisher_matching(const zloam_publisher*, bool* out) {
  *out = true;
  return ZLOAM_OK;
}
zloam_status zloam_publisher_on_matching(const zloam_publisher*, zloam_on_matching call,
                                         void* context, zloam_drop_fn drop) {
  call(context, true);
  drop(context);
  return ZLOAM_OK;
}
void zloam_publisher_drop(zloam_publisher* publisher) { delete publisher; }
zloam_status zloam_session_put(const zloam_session*, zloam_slice, const zloam_bytes* payload,
                               const zloam_publisher_options* options) {
  return published(text(options->encoding), payload);
}
zloam_status zloam_session_delete(const zloam_session*, zloam_slice) { return ZLOAM_OK; }

zloam_status zloam_session_declare_subscriber(const zloam_session*, zloam_slice key,
                                              zloam_on_sample call, void* context,
                                              zloam_drop_fn drop, zloam_subscriber** out) {
  *out = new zloam_subscriber{text(key), false, call, context, drop};
  const std::lock_guard lock(mutex);
  subscribers.push_back(*out);
  return ZLOAM_OK;
}
void zloam_subscriber_drop(zloam_subscriber* subscriber) { undeclare(subscribers, subscriber); }

zloam_status zloam_session_declare_queryable(const zloam_session*, zloam_slice key, bool,
                                             zloam_on_query call, void* context, zloam_drop_fn drop,
                                             zloam_queryable** out) {
  *out = new zloam_queryable{text(key), call, context, drop};
  const std::lock_guard lock(mutex);
  queryables.push_back(*out);
  return ZLOAM_OK;
}
void zloam_queryable_drop(zloam_queryable* queryable) { undeclare(queryables, queryable); }
void zloam_query_view_of(const zloam_query* query, zloam_query_view* out) {
  *out = {slice(query->key), slice(query->parameters), copied(query->payload)};
}
zloam_status zloam_query_reply(const zloam_query*, zloam_slice, const zloam_bytes* payload,
                               zloam_slice encoding, const zloam_bytes*) {
  return published(text(encoding), payload);
}
zloam_status zloam_query_reply_error(const zloam_query*, const zloam_bytes*) { return ZLOAM_OK; }
void zloam_query_drop(zloam_query* query) { delete query; }

zloam_status zloam_session_get(const zloam_session*, zloam_slice selector, const zloam_bytes*,
                               std::uint64_t, bool, zloam_on_reply call, void* context,
                               zloam_drop_fn drop) {
  const std::string whole = text(selector);
  if (network.on_get) {
    for (const NetMessage& answer : network.on_get(whole.substr(0, whole.find('?')))) {
      const zloam_sample sample = sample_of(answer, 0);
      call(context, &sample, nullptr);
    }
  }
  drop(context);
  return ZLOAM_OK;
}

zloam_status zloam_session_declare_token(const zloam_session*, zloam_slice, zloam_token** out) {
  *out = new zloam_token;
  return ZLOAM_OK;
}
void zloam_token_drop(zloam_token* token) { delete token; }
zloam_status zloam_session_declare_liveliness_subscriber(const zloam_session*, zloam_slice key,
                                                         bool, zloam_on_sample call, void* context,
                                                         zloam_drop_fn drop,
                                                         zloam_subscriber** out) {
  *out = new zloam_subscriber{text(key), true, call, context, drop};
  const std::lock_guard lock(mutex);
  subscribers.push_back(*out);
  return ZLOAM_OK;
}
zloam_status zloam_session_liveliness_get(const zloam_session*, zloam_slice key, std::uint64_t,
                                          zloam_on_reply call, void* context, zloam_drop_fn drop) {
  NetMessage token{text(key), {}, {}};
  std::replace(token.key.begin(), token.key.end(), '*', 'x');
  const zloam_sample sample = sample_of(token, 0);
  call(context, &sample, nullptr);
  drop(context);
  return ZLOAM_OK;
}

}  // extern "C"
