/* C ABI of the Zenoh bridge (Rust crate zloam-zenoh). check_header.py compares it with src/.
 *
 *  - Handles are opaque. zloam_*_drop takes null; handles passed in elsewhere are only borrowed.
 *  - A status other than ZLOAM_OK comes with a text: zloam_last_error(), on the same thread.
 *    Nothing unwinds: a panic in the bridge is ZLOAM_PANIC. Callbacks must not throw.
 *  - A closure is (call, context, drop), used on any thread, possibly several at a time. drop is
 *    called exactly once, after the last call, also when the function that took it fails.
 *  - Dropping an entity undeclares it and waits for its running callbacks: so never inside one.
 */
#ifndef ZLOAM_ZENOH_H
#define ZLOAM_ZENOH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef int32_t zloam_status;
#define ZLOAM_OK 0
#define ZLOAM_ERROR (-1)
#define ZLOAM_PANIC (-2)

typedef struct zloam_bytes zloam_bytes;
typedef struct zloam_config zloam_config;
typedef struct zloam_session zloam_session;
typedef struct zloam_publisher zloam_publisher;
typedef struct zloam_subscriber zloam_subscriber;
typedef struct zloam_queryable zloam_queryable;
typedef struct zloam_query zloam_query;
typedef struct zloam_token zloam_token;

/* A borrowed range of bytes (texts: UTF-8 without a terminator); data may be null when size is 0.
 */
typedef struct zloam_slice {
  const uint8_t* data;
  size_t size;
} zloam_slice;

/* Valid during the call it is passed to, except payload and attachment, which the callee owns;
 * attachment is null when there is none. */
typedef struct zloam_sample {
  zloam_slice key;
  zloam_slice encoding;
  zloam_bytes* payload;
  zloam_bytes* attachment;
  uint8_t kind;               /* 0 put, 1 delete */
  uint8_t priority;           /* 1 real time .. 7 background */
  uint8_t congestion_control; /* 0 drop, 1 block */
  bool express;
} zloam_sample;

typedef struct zloam_publisher_options {
  zloam_slice encoding; /* empty: Zenoh's default */
  uint8_t congestion_control;
  uint8_t priority;
  bool express;
  bool reliable;
} zloam_publisher_options;

/* Valid as long as the query, except payload, which the caller owns (null: none). */
typedef struct zloam_query_view {
  zloam_slice key;
  zloam_slice parameters;
  zloam_bytes* payload;
} zloam_query_view;

typedef void (*zloam_drop_fn)(void* context);
typedef void (*zloam_on_sample)(void* context, const zloam_sample* sample);
typedef void (*zloam_on_matching)(void* context, bool matching);
/* The callee owns the query and ends it with zloam_query_drop, on any thread. */
typedef void (*zloam_on_query)(void* context, zloam_query* query);
/* Either a sample, or the payload of an error reply, which the callee owns. */
typedef void (*zloam_on_reply)(void* context, const zloam_sample* sample, zloam_bytes* error);

/* Text of the last failed call on this thread; valid until the next failed call on it. */
const char* zloam_last_error(void);
/* For tests: panics with the text. */
zloam_status zloam_test_panic(zloam_slice text);
/* Zenoh's log to standard error; RUST_LOG overrides the level given here. */
zloam_status zloam_init_log(zloam_slice fallback_level);

/* Bytes. own: no copy, drop(context) frees the memory when the last reference goes. */
zloam_status zloam_bytes_own(const uint8_t* data, size_t size, void* context, zloam_drop_fn drop,
                             zloam_bytes** out);
zloam_status zloam_bytes_copy(zloam_slice data, zloam_bytes** out);
/* A copy in slices of at most part bytes. */
zloam_status zloam_bytes_in_parts(const zloam_bytes* bytes, size_t part, zloam_bytes** out);
void zloam_bytes_drop(zloam_bytes* bytes);
size_t zloam_bytes_size(const zloam_bytes* bytes);
bool zloam_bytes_is_shared_memory(const zloam_bytes* bytes);
/* False once shared memory may have been overwritten: bytes read before may be invalid. */
bool zloam_bytes_is_intact(const zloam_bytes* bytes);
/* The bytes in place; false when they are in several fragments. */
bool zloam_bytes_view(const zloam_bytes* bytes, zloam_slice* out);
/* All fragments, one after the other, to size bytes at destination. */
void zloam_bytes_copy_to(const zloam_bytes* bytes, uint8_t* destination);

/* Configuration (JSON5). */
zloam_status zloam_config_default(zloam_config** out);
zloam_status zloam_config_from_text(zloam_slice json5, zloam_config** out);
zloam_status zloam_config_from_file(zloam_slice path, zloam_config** out);
zloam_status zloam_config_insert(zloam_config* config, zloam_slice key, zloam_slice json5);
void zloam_config_drop(zloam_config* config);

/* Session. The handle must outlive the calls that take it, not the entities made from it; the last
 * handle's drop closes. close: false at closed when the deadline passed first. */
zloam_status zloam_session_open(const zloam_config* config, zloam_session** out);
zloam_status zloam_session_close(const zloam_session* session, uint64_t deadline_ms, bool* closed);
void zloam_session_drop(zloam_session* session);
/* Writes the id's hexadecimal digits (at most 32, no terminator), returns their number. */
size_t zloam_session_zid(const zloam_session* session, uint8_t* buffer, size_t capacity);
/* Writes the other ends of its links, such as tcp/192.168.1.5:7447, one a line, as far as they have
 * room; returns the size of all. */
size_t zloam_session_links(const zloam_session* session, uint8_t* buffer, size_t capacity);

/* Publish and subscribe. A null payload is an empty one; a null attachment is none. */
zloam_status zloam_session_declare_publisher(const zloam_session* session, zloam_slice key,
                                             const zloam_publisher_options* options,
                                             zloam_publisher** out);
zloam_status zloam_publisher_put(const zloam_publisher* publisher, const zloam_bytes* payload,
                                 const zloam_bytes* attachment);
zloam_status zloam_publisher_delete(const zloam_publisher* publisher);
zloam_status zloam_publisher_matching(const zloam_publisher* publisher, bool* out);
zloam_status zloam_publisher_on_matching(const zloam_publisher* publisher, zloam_on_matching call,
                                         void* context, zloam_drop_fn drop);
void zloam_publisher_drop(zloam_publisher* publisher);
zloam_status zloam_session_put(const zloam_session* session, zloam_slice key,
                               const zloam_bytes* payload, const zloam_publisher_options* options);
zloam_status zloam_session_delete(const zloam_session* session, zloam_slice key);
zloam_status zloam_session_declare_subscriber(const zloam_session* session, zloam_slice key,
                                              zloam_on_sample call, void* context,
                                              zloam_drop_fn drop, zloam_subscriber** out);
void zloam_subscriber_drop(zloam_subscriber* subscriber);

/* Queries. get returns at once; its drop is called after the last answer or the timeout. */
zloam_status zloam_session_declare_queryable(const zloam_session* session, zloam_slice key,
                                             bool complete, zloam_on_query call, void* context,
                                             zloam_drop_fn drop, zloam_queryable** out);
void zloam_queryable_drop(zloam_queryable* queryable);
void zloam_query_view_of(const zloam_query* query, zloam_query_view* out);
zloam_status zloam_query_reply(const zloam_query* query, zloam_slice key,
                               const zloam_bytes* payload, zloam_slice encoding,
                               const zloam_bytes* attachment);
zloam_status zloam_query_reply_error(const zloam_query* query, const zloam_bytes* payload);
void zloam_query_drop(zloam_query* query);
zloam_status zloam_session_get(const zloam_session* session, zloam_slice selector,
                               const zloam_bytes* payload, uint64_t timeout_ms, bool target_all,
                               zloam_on_reply call, void* context, zloam_drop_fn drop);

/* Liveliness. */
zloam_status zloam_session_declare_token(const zloam_session* session, zloam_slice key,
                                         zloam_token** out);
void zloam_token_drop(zloam_token* token);
zloam_status zloam_session_declare_liveliness_subscriber(const zloam_session* session,
                                                         zloam_slice key, bool history,
                                                         zloam_on_sample call, void* context,
                                                         zloam_drop_fn drop,
                                                         zloam_subscriber** out);
zloam_status zloam_session_liveliness_get(const zloam_session* session, zloam_slice key,
                                          uint64_t timeout_ms, zloam_on_reply call, void* context,
                                          zloam_drop_fn drop);

#ifdef __cplusplus
}
#endif

#endif
